"""Folders database/ and queries/ with positions in the file names, as VPR-datasets-downloader makes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, Unpack

from vprbench.api import BadInput, Dataset, MissingData, Paths

from .readers.csv_tables import find_encoding
from .readers.file_dataset import OWN_FILES, FileOptions, dataset_of_files, unknown
from .readers.frame_folders import find_root, list_folders
from .readers.image_files import find_listed, images_in
from .readers.positions import WithoutPosition
from .readers.utm_names import Zones, match_names

_LAYOUT = (
    "github.com/gmberton/VPR-datasets-downloader makes such folders and says for which you have to register or to ask "
    "(MSLS, Pitts30k, Tokyo 24/7); set dataset.root"
)


def utm_folders(
    name: str = "utm_folders",
    root: str | None = None,
    split: str = "test",
    database: str = "database",
    queries: str = "queries",
    radius_metres: float = 25.0,
    ground_truth: Literal["utm", "none"] = "utm",
    without_position: WithoutPosition = "error",
    zones: Zones = "error",
    **options: Unpack[FileOptions],
) -> Dataset:
    """Return the images below `database` and `queries`, named @UTM_east@UTM_north@..., in the order of their paths.

    The two folders lie in `<root>/images/<split>`, in `<root>/<split>` or in `root` itself. Where a file
    `<folder>_images_paths.txt` lies beside a folder, it alone says which images are used, and in which order. Every
    reference is a place; right is what lies within `radius_metres`, the radius included. Names of several UTM zones are
    an error, unless images of different zones never show one place (`zones` apart). With `ground_truth` none any name
    is taken, and no answer is judged. `without_position` is that of `match_positions`. Options that are not given are
    those of your own files (`OWN_FILES`), but `unmatched` is keep, as in gmberton/VPR-methods-evaluation. Raises
    MissingData for what is missing, BadInput for names without a position and for a list that is no text.
    """
    layout = f"{_LAYOUT} so that <root>/images/{split} holds {database}/ and {queries}/"
    top = find_root(name, root, f"{database}/ and {queries}/", layout)
    found, holding = _find_split(top, split, (database, queries), layout)
    folders = holding / database, holding / queries
    lists = [beside.name for folder in folders if (beside := _list_beside(folder)).is_file()]
    map_files, query_files = (_list_images(folder, layout) for folder in folders)
    protocol: dict[str, Any] = {"protocol": "utm_folders", "split": found, "database": database, "queries": queries}
    if lists:
        protocol["lists"] = lists
    if ground_truth == "utm":
        truth = match_names(map_files, query_files, radius_metres, zones, without_position)
        protocol |= {"radius_metres": radius_metres, "zones": zones}
    else:
        truth = unknown(len(map_files), len(query_files))
    options = OWN_FILES | FileOptions(unmatched="keep") | options
    return dataset_of_files(name, map_files, query_files, truth, protocol, **options)


def _find_split(top: Path, split: str, wanted: tuple[str, str], layout: str) -> tuple[str | None, Path]:
    """Return the split, None if the root is not divided, and the folder that holds both wanted folders."""
    for outer in ([top], list_folders(top)):  # the only folder of the root comes after the root, as a zip is unpacked
        for found, way in ((split, Path("images", split)), (split, Path(split)), (None, Path())):
            holding = [each / way for each in outer if all((each / way / part).is_dir() for part in wanted)]
            if len(holding) == 1:
                return found, holding[0]
    raise MissingData(
        f"{' and '.join(f'{part}/' for part in wanted)} are neither in {top / 'images' / split} nor in {top / split} "
        f"nor in {top}: {layout}"
    )


def _list_images(folder: Path, layout: str) -> Paths:
    """Return the images of a folder: the images of the list beside it, if there is a list, else all, by their paths."""
    beside = _list_beside(folder)
    if not beside.is_file():
        return images_in(folder, "dataset.root", layout, order="plain")
    try:
        named = [line for line in beside.read_text(encoding=find_encoding(beside)).splitlines() if line.strip()]
    except UnicodeError as error:
        raise BadInput(f"{beside} is no text in UTF-8 ({error}): save it as such, or delete it") from error
    if not named:
        raise MissingData(f"{beside} names no image: delete it to use all images of {folder}")
    advice = f"restore them, or delete {beside} to use all images of the folder"
    return find_listed(Paths.below(folder, named), beside.name, advice)


def _list_beside(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}_images_paths.txt")
