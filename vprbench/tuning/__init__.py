"""The hyperparameter search of the VPRTempo paper: a random search, then a grid around its best, on places apart."""
