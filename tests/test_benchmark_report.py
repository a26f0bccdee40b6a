"""What a benchmark measured is a line of the document, whatever it tells beside its times."""

import report


def test_a_measurement_is_a_line_with_its_rate_and_what_it_tells_beside():
    about = {"what": "sad", "images": 2, "calls": 10, "beside": {"reads": 0.001}, "numbers": 1234, "found": "99.5"}
    text = report.document(
        {"benchmarks": [{"group": "G.", "extra_info": about, "stats": {"median": 0.1, "iqr": 0.01}}]}
    )
    (line,) = [line for line in text.splitlines() if line.startswith("| sad")]
    assert [cell.strip() for cell in line.split("|")[1:-1]] == [
        *("sad", "10", "200", "10 %", "1,234", "99.5"),
        "reads 1 ms (10x)",
    ]
