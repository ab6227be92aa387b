"""What runs leave behind: the store, its provenance, the paper's numbers, statistics and tables."""
