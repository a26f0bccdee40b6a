"""Datasets: downloaded, checked and unpacked."""
