"""What the benchmark of speed says of reading files."""

from __future__ import annotations

from vprbench.speed.format import figures, megabytes, ratio, table
from vprbench.speed.measure import median
from vprbench.speed.settings import ReadingCell, Report


def reading(report: Report) -> list[str]:
    """Return the section on files."""
    settings = report.settings
    height, width = settings.frame
    return [
        "## Reading frames from files",
        f"{settings.reading_frames:,} PNG files of {width}x{height} frames, drawn ones, {settings.reading_files:,} of "
        "them different and the others hard links to these, in a process of its own. A bare loop decodes one file "
        "after the other; in turn with it as many such loops run at once as there are cores, each in a thread, and "
        "this project reads ahead and hands the frames out in order. Reading takes all cores, whatever `threads` says. "
        "Shares are medians over the turns. Where other programs share the cores, one loop alone gets more of a core "
        "than each of several does, and only the share of the loops at once compares like with like. Resident memory "
        "holds the libraries too.",
        table(report.reading, _reading_row),
    ]


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
