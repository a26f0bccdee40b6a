"""One self-contained HTML page from stored runs: the table, the figures, and a browser of single queries."""
