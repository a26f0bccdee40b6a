"""Pure functions of scores and outcomes: accuracy, its intervals, and how times grow."""
