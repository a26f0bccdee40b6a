"""A comparison: several methods on data of one's own, ranked in one table, with figures and a page."""
