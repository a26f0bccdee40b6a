"""What a plug-in is written against."""
