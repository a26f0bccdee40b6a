"""Files: whole, hashed, cached, downloaded, unpacked."""
