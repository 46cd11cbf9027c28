"""Results of the paper for its own experiments, and the requirements on ours."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperFigures:
    """Figures of one experiment of Sutton et al. 2007, part II; None where it gives none."""

    title: str
    displacement_sd_px: float
    displacement_reported: str
    distortion_residual_px: float
    distortion_reported: str
    strain_mean: dict[str, float]
    strain_mean_reported: dict[str, str]
    strain_sd: dict[str, float]
    strain_sd_reported: dict[str, str]
    youngs_modulus_gpa: float
    poissons_ratio: float
    required_noise_px: float
    modulus_reported: str


PAPER = {
    "paper_x200": PaperFigures(
        title="x200",
        displacement_sd_px=0.02,
        displacement_reported="0.02 px (range ±0.1 px)",
        distortion_residual_px=0.02,
        distortion_reported="±0.02 px (its simulation; none given for the experiment)",
        strain_mean={"calibration": 6e-5, "translation": 6e-5},
        strain_mean_reported={"calibration": "“near zero” (±6e-5 in its simulation)", "translation": "“near zero”"},
        strain_sd={"calibration": 6e-5, "translation": 7e-5},
        strain_sd_reported={"calibration": "6e-5", "translation": "7e-5", "tension": "no figure"},
        youngs_modulus_gpa=71.1,
        poissons_ratio=0.33,
        required_noise_px=0.025,
        modulus_reported="71.1 GPa, “nearly the same” as the strain gage",
    ),
    "paper_x10000": PaperFigures(
        title="x10,000",
        displacement_sd_px=0.02,
        displacement_reported="0.02 px in its abstract, range ±0.2 px in its text (twice x200)",
        distortion_residual_px=0.02,
        distortion_reported="±0.02 px (its simulation; none given for the experiment)",
        strain_mean={"calibration": 1.5e-4},
        strain_mean_reported={"calibration": "< 1.5e-4"},
        strain_sd={"calibration": 1.5e-4},
        strain_sd_reported={"calibration": "< 1.5e-4", "tension": "no figure"},
        youngs_modulus_gpa=71.1,
        poissons_ratio=0.33,
        required_noise_px=0.05,
        modulus_reported="no figure; plotted together with x200",
    ),
}

RATIO_BAR = 1.1
# The paper's gage and DIC both round to 71.1 GPa, so they differ by less than 0.1; its Poisson's ratio has two digits.
MODULUS_BAR_GPA = 0.1
RATIO_OF_POISSON_BAR = 0.01
CORRECTION_SD_BAR = 4e-5  # 9 x 9 points, DIC noise correlated over 43 px
DISTORTION_BAR_PX = 0.03
STATED_WINDOW = 9
CURVE_WINDOWS = tuple(range(3, 42, 2))
WIDER_WINDOWS = (45, 51, 57, 63, 71, 79, 87, 95)
QUICK_WINDOWS = (3, 9, 21)
