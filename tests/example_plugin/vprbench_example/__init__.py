"""A method and a dataset for vprbench in a package of their own."""
