"""A method for vprbench in a package of its own."""
