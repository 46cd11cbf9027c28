"""What holds for every test."""

from __future__ import annotations

import pytest

from semlive.service.blas import one_blas_thread


@pytest.fixture(scope="session", autouse=True)
def sums_in_one_order() -> None:
    """As in every analysis; choices that lie close together may fall otherwise with sums in another order."""
    one_blas_thread()
