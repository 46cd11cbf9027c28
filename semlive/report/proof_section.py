"""The section of a confirmation by simulation: the gap before, after, and by noise alone."""

from __future__ import annotations

from semlive.diagnose.residual_channels import ChannelResidual
from semlive.diagnose.simulation_comparison import Comparison, Proof
from semlive.report.diagnosis_figures import misfit_bars
from semlive.report.document.blocks import Block, FigureBlock, Paragraph, Section, Table
from semlive.report.sections.wording import with_sigma

_CHANNELS = {
    "x": "along x",
    "y": "along y",
    "x_smooth": "along x, smooth part",
    "y_smooth": "along y, smooth part",
}


def proof_section(proof: Proof) -> Section:
    """Gap between measurement and model without the effects, with them, and by noise alone.

    Args:
        proof: result of the confirmation.
    """
    blocks = _simulated(proof, proof.comparison) if proof.comparison is not None else _not_simulated(proof)
    return Section("Confirmation by simulation", (*blocks, _channel_table(proof)))


def _simulated(proof: Proof, comparison: Comparison) -> tuple[Block, ...]:
    maps, sizes = comparison.maps, comparison.sizes
    low, high = maps.interval
    caption = (
        "The run was simulated twice, without and with the identified effects, by an implementation that shares no code with "
        "the diagnosis. "
        f"Root mean square of measured minus simulated maps, {comparison.frames} frames of {comparison.blocks} blocks: the effects close "
        f"{100 * maps.closure:.0f} % of the misfit, 95 % interval {100 * low:.0f} to {100 * high:.0f} %."
    )
    text = f"{'Confirmed' if comparison.confirmed else 'Not confirmed'}. Added: {', '.join(proof.added)}."
    if sizes.measured_px > 0.0:
        text += (
            f" Smooth residual above noise: {sizes.measured_px:.4f} px measured, {sizes.simulated_px:.4f} px simulated with the effects."
        )
    text += f" Bound of the work: two simulated runs of {proof.pairs} pairs each, as many as were measured."
    figure = misfit_bars(maps.before_px, maps.after_px, maps.floor_px)
    return (Paragraph(text), FigureBlock("misfit-simulated", "Misfit between measurement and simulation", caption, figure))


def _not_simulated(proof: Proof) -> tuple[Block, ...]:
    return (Paragraph(f"Nothing was added and nothing was simulated: {proof.reason}. The table shows the gap as measured."),)


def _channel_table(proof: Proof) -> Table:
    gap = "Residual of the maps" if proof.comparison is None else "Measured minus simulated maps"
    caption = (
        f"{gap}, root mean square in standard deviations of the noise, with standard uncertainties. Smooth part: coefficients of "
        "polynomials up to the fourth order in each frame. Without a missing effect, the residual before is that of noise."
    )
    headings = ("channel", "before", "after", "by noise alone")
    return Table(caption, headings, tuple(_row(item) for item in proof.channels), text=False)


def _row(item: ChannelResidual) -> tuple[str, str, str, str]:
    after = "nothing added" if item.after is None else with_sigma(item.after.value, item.after.sigma)
    return (
        _CHANNELS[item.channel],
        with_sigma(item.before.value, item.before.sigma),
        after,
        with_sigma(item.expected.value, item.expected.sigma),
    )
