"""What the benchmark of speed says of reading files and of preprocessed traverses."""

from __future__ import annotations

from vprbench.speed.format import figures, megabytes, ratio, table
from vprbench.speed.measure import median
from vprbench.speed.settings import KeptCell, ReadingCell, Report


def reading(report: Report) -> list[str]:
    """Return the section on files."""
    settings = report.settings
    height, width = settings.frame
    read = [cell for cell in report.reading if not isinstance(cell, KeptCell)]
    kept = [cell for cell in report.reading if isinstance(cell, KeptCell)]
    return [
        "## Reading frames from files",
        f"{settings.reading_frames:,} PNG files of {width}x{height} frames, drawn ones, {settings.reading_files:,} of "
        "them different and the others hard links to these, in a process of its own. A bare loop decodes one file "
        "after the other; in turn with it as many such loops run at once as there are cores, each in a thread, and "
        "this project reads ahead and hands the frames out in order. Reading takes all cores, whatever `threads` says. "
        "Shares are medians over the turns. Where other programs share the cores, one loop alone gets more of a core "
        "than each of several does, and only the share of the loops at once compares like with like. Resident memory "
        "holds the libraries too.",
        table(read, _reading_row),
        *([_PREPROCESSED.format(settings.pixels), table(kept, _kept_row)] if kept else []),
    ]


_PREPROCESSED = (
    "Patch normalisation (variant C) to {0}x{0} pixels of a part of these files, reading included, and the same again "
    "from the cache, memory-mapped, until every pixel was looked at:"
)


def _reading_row(cell: ReadingCell) -> dict[str, str]:
    turns = list(zip(cell.one_loop, cell.loops_at_once, cell.ahead, strict=True))
    return {
        "frame": f"{cell.width}x{cell.height}",
        "frames": f"{cell.frames:,}",
        "cores": str(cell.cores),
        "one bare loop: Hz": figures(median(cell.one_loop)),
        "loops at once: Hz": figures(median(cell.loops_at_once)),
        "ours: Hz": figures(median(cell.ahead)),
        "ours / (cores x one loop)": ratio(median(ours / one for one, _, ours in turns), cell.cores),
        "ours / loops at once": ratio(median(ours / several for _, several, ours in turns), 1),
        "resident before MB": megabytes(cell.memory_before_bytes),
        "peak MB": megabytes(cell.peak_memory_bytes),
    }


def _kept_row(cell: KeptCell) -> dict[str, str]:
    again = median(cell.again_seconds)
    return {
        "frames": f"{cell.frames:,}",
        "made s": figures(cell.made_seconds),
        "made: Hz": figures(cell.frames / cell.made_seconds),
        "again ms": figures(1e3 * again),
        "again: Hz": figures(cell.frames / again),
        "made / again": ratio(cell.made_seconds, again),
        "on disk MB": figures(cell.kept_bytes / 1e6),
        "resident before MB": megabytes(cell.memory_before_bytes),
        "peak MB": megabytes(cell.peak_memory_bytes),
    }
