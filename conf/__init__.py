"""The configuration of vprbench: one yaml a method, one a dataset, and the run itself."""
