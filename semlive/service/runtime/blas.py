"""Number of threads of linear algebra."""

from __future__ import annotations

from threadpoolctl import threadpool_limits


def limit_blas_threads() -> None:
    """Limit the linear algebra of this process to one thread.

    Sums then have a fixed order, so a replay gives the same bytes as the live run. One thread is also faster for matrices of a few hundred
    rows: with both cores busy, a solution took 1.1 s in two threads and 0.2 s in one.
    """
    threadpool_limits(limits=1, user_api="blas")
