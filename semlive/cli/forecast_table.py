"""What experiments are expected to decide, as a table."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from semlive.data.diagnosis.verdict import ExperimentForecast


def forecast_table(forecasts: Sequence[ExperimentForecast]) -> Table:
    """One line for each, the most for a minute of beam time first."""
    table = Table(title="what experiments are expected to decide")
    for heading in ("experiment", "minutes", "ln odds", "a minute", "hardest to tell apart, the first being true"):
        table.add_column(heading)
    for one in forecasts:
        table.add_row(
            one.summary, f"{one.minutes:.0f}", f"{one.log_odds:.1f}", f"{one.log_odds_per_minute:.2f}", f"{one.true}, {one.other}"
        )
    return table
