"""How fast this machine trains, answers and describes."""
