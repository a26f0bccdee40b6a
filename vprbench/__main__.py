"""Makes `python -m vprbench` the command line."""

from vprbench.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
