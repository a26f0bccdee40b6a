"""What a person sees in a terminal: tables that fit it, a live table, and the standard streams."""
