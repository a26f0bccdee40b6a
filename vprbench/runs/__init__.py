"""One run: found or made, timed, recorded, stored and summarised."""
