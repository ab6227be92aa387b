"""The domains as Gymnasium environments; importing this package registers them (``bgn/Hallway-v0``, …)."""

from bgn.environments.registration import register

register()
