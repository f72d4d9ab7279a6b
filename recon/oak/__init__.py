"""Recording with OAK-D cameras, and what becomes of the recording: the PLUSH layout."""
