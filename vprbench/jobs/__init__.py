"""Many runs: each in a process of its own, one after the other or side by side on dask."""
