"""Which files are images: the formats that are decoded, the suffixes they go by, and what may lie beside frames."""

from __future__ import annotations

from pathlib import Path

from PIL import Image as PillowImage

#: Pillow knows many more, some of which start other programs (EPS) or have no use here.
FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP", "PPM")
IMAGE_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".jpe", ".jfif", ".bmp", ".tif", ".tiff", ".webp"),
    *(".ppm", ".pgm", ".pbm", ".pnm"),
)

# In small letters.
_FOLDERS_BESIDE = {"@eadir", "__macosx", "$recycle.bin", "system volume information"}
_FILES_BESIDE = {
    *("icon\r", "readme", "license", "licence", "copying", "citation", "changelog"),
    *("sha256sums", "md5sums", "checksums"),
}
_SUFFIXES_BESIDE = {
    *(".txt", ".md", ".rst", ".html", ".pdf", ".bib", ".log"),
    *(".csv", ".tsv", ".json", ".jsonl", ".geojson", ".yaml", ".yml", ".xml", ".toml", ".ini", ".cfg", ".gpx", ".kml"),
    *(".npy", ".npz", ".mat", ".pkl", ".pickle", ".h5", ".hdf5", ".parquet", ".db", ".sqlite"),
    *(".py", ".m", ".sh", ".ipynb", ".md5", ".sha256"),
    *(".mp4", ".avi", ".mov", ".mkv", ".webm"),
}


def open_image(path: Path) -> PillowImage.Image:
    """Open an image of one of the formats, of which nothing is decoded yet; to be closed by the caller.

    Raises what Pillow does: UnidentifiedImageError, an OSError, for any other content, whatever its name.
    """
    return PillowImage.open(path, formats=FORMATS)


def is_image_name(name: str) -> bool:
    """Tell whether a file of this name is an image by its suffix."""
    return name.lower().endswith(IMAGE_SUFFIXES)


def is_beside(name: str) -> bool:
    """Tell whether a file of this name lies beside frames and is none: hidden, a system's own, a document, a list."""
    lower = name.lower()
    return name.startswith(".") or lower in _FILES_BESIDE or Path(lower).suffix in _SUFFIXES_BESIDE


def is_folder_beside(name: str) -> bool:
    """Tell whether a folder of this name holds no frames: hidden, or a system's own."""
    return name.startswith(".") or name.lower() in _FOLDERS_BESIDE
