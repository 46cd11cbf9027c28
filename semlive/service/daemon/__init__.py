"""A run from the configuration to the finished log: start-up, devices, protocol, shutdown."""

from semlive.service.daemon.daemon import run_experiment
from semlive.service.daemon.run_interface import RunInterface, RunOutcome

__all__ = ["RunInterface", "RunOutcome", "run_experiment"]
