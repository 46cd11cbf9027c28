"""Named distortions for scenarios.

Of the fields in Fig. 11 of the paper, only these values of its text are available: their ranges, and the strain errors of a translation by
5 px (its Fig. 16, stated for x10,000, "similar results" for x200). A quadratic surface, two oblique waves and the settling of the beam at
the start of lines and frames were fitted to these ten numbers over the field of the paper (150 x 120 points), and agree with them within
1 %:

=========  ===================  ===================  =========================================================
field      x                    y                    strain errors for 5 px in x and y: exx, exy, eyy (1e-4)
=========  ===================  ===================  =========================================================
x200       -0.60 ... 1.00 px    -0.50 ... 2.00 px    -1.5 ... 1.0, -3.3 ... 4.3, -4.0 ... 6.0
x10,000    -0.50 ... 0.50 px    -0.40 ... 2.60 px    the same
=========  ===================  ===================  =========================================================
"""

from __future__ import annotations

from semlive_simulators.effects.distortion import AxisDistortion, Distortion

SHAPES: dict[str, Distortion] = {
    "fig11_x200": Distortion(
        x=AxisDistortion(
            constant_px=0.257, xx_px=-0.464, xy_px=-0.364, yy_px=0.03, wave_px=0.542, wave_x=-0.003, wave_y=1.52, wave_phase_rad=0.911,
            ripple_px=0.347, ripple_x=1.284, ripple_y=0.159, ripple_phase_rad=-2.896,
            left_px=0.45, left_reach=0.12, top_px=0.15, top_reach=0.15,
        ),
        y=AxisDistortion(
            constant_px=0.361, xx_px=0.259, xy_px=0.313, yy_px=0.358, wave_px=0.542, wave_x=0.965, wave_y=0.655, wave_phase_rad=-1.679,
            ripple_px=0.512, ripple_x=1.353, ripple_y=1.232, ripple_phase_rad=0.192,
            left_px=-0.3, left_reach=0.12, top_px=0.5, top_reach=0.15,
        ),
    ),
    "fig11_x10000": Distortion(
        x=AxisDistortion(
            constant_px=0.095, xx_px=-0.643, xy_px=-0.3, yy_px=0.174, wave_px=0.194, wave_x=0.489, wave_y=1.404, wave_phase_rad=0.48,
            ripple_px=0.202, ripple_x=1.785, ripple_y=-0.509, ripple_phase_rad=-1.115,
            left_px=0.25, left_reach=0.12, top_px=0.1, top_reach=0.15,
        ),
        y=AxisDistortion(
            constant_px=0.407, xx_px=0.27, xy_px=0.452, yy_px=0.744, wave_px=0.416, wave_x=1.142, wave_y=0.765, wave_phase_rad=-1.176,
            ripple_px=0.576, ripple_x=1.613, ripple_y=1.04, ripple_phase_rad=-0.117,
            left_px=0.5, left_reach=0.12, top_px=0.35, top_reach=0.15,
        ),
    ),
}  # fmt: skip
"""Distortions by name, for ``distortion: fig11_x200`` in a scenario."""


def named(chosen: object) -> object:
    """A distortion by its name; other values are returned unchanged.

    Raises:
        ValueError: if no distortion has the name.
    """
    if not isinstance(chosen, str):
        return chosen
    if chosen not in SHAPES:
        raise ValueError(f"there is no distortion {chosen}; choose {', '.join(SHAPES)}, or give its coefficients")
    return SHAPES[chosen]
