"""Settings of all tests."""

import os

from hypothesis import settings

# Numerical libraries keep to one thread: test processes run side by side, and small products gain nothing.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# A busy machine is slow, not wrong.
settings.register_profile("bgn", deadline=None)
settings.load_profile("bgn")
