"""Training of one cell of the benchmark (domain x agent), all its seeds at once."""
