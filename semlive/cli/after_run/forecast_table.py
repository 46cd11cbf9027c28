"""Table of the expected results of proposed experiments."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from semlive.data.diagnosis.verdict import ExperimentForecast


def forecast_table(forecasts: Sequence[ExperimentForecast]) -> Table:
    """One row for each experiment, in the order of the argument: most log odds per minute of beam time first."""
    table = Table(title="expected results of experiments")
    for heading in ("experiment", "minutes", "ln odds", "per minute", "pair of effects that is hardest to distinguish, true effect first"):
        table.add_column(heading)
    for forecast in forecasts:
        table.add_row(
            forecast.summary,
            f"{forecast.minutes:.0f}",
            f"{forecast.log_odds:.1f}",
            f"{forecast.log_odds_per_minute:.2f}",
            f"{forecast.true}, {forecast.other}",
        )
    return table
