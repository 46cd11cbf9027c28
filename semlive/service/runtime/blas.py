"""Number of threads of linear algebra."""

from __future__ import annotations

from threadpoolctl import threadpool_limits


def limit_blas_threads() -> None:
    """Let this process do its linear algebra in one thread.

    Sums then have one order, so a replay gives the same bytes as the live run; and the estimator's matrices of a few
    hundred rows are faster so: with both cores busy, two threads took 1.1 s for a solution that one does in 0.2 s.
    """
    threadpool_limits(limits=1, user_api="blas")
