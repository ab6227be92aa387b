"""Keeps numerical libraries to one thread: test processes run side by side, and small products gain nothing."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
