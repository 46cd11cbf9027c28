"""What holds for every test."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, settings

from semlive.service.runtime.blas import limit_blas_threads

# How long an example takes by the wall says how busy the computer is; where it matters a test counts its own processor time.
settings.register_profile("semlive", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("semlive")


@pytest.fixture(scope="session", autouse=True)
def sums_in_one_order() -> None:
    """As in every analysis; choices that lie close together may fall otherwise with sums in another order."""
    limit_blas_threads()
