"""The sub-commands of ``bgn``, one module each."""
