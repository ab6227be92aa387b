"""Where tasks run: worker processes, or the streams of one GPU."""
