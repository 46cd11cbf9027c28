"""Truth of a simulation in the quantities of the measurement; used for scores only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, RectBivariateSpline

from semlive.data.frame import FrameInfo
from semlive.errors import BadInput
from semlive.inputs.files import read_regular
from semlive.inputs.json_text import parse_json

Field = NDArray[np.float64]
_VISITS = 64  # samples of the drift of a frame; cubic interpolation between them is exact to 1e-9 px for drift over minutes
_MOST_BYTES = 500_000_000  # largest accepted truth file; one of a week has some MB
_REFINEMENTS = 5  # fixed-point iterations; each reduces the error by a factor of 100


@dataclass(frozen=True, slots=True, eq=False)
class TrueFrame:
    """True motion of the specimen in one frame: material point xi is at ``xi + shift + gradient (xi - centre)``.

    Attributes:
        start_ns: true start of the scan, UTC ns.
        row_time_s: true row time.
        shift_px: (2,) motion of the centre.
        gradient: (2, 2) displacement gradient.
    """

    start_ns: int
    row_time_s: float
    shift_px: Field
    gradient: Field


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """A simulator's truth.

    Attributes:
        youngs_modulus_gpa: E.
        poissons_ratio: nu.
        centre_px: (2,) centre of the gradients.
        frames: true frames by name of the exported file.
        start_ns: origin of the drift's time, UTC ns.
        drift: (2,) drift in px as a function of seconds since then.
        distortion_px: distortion E(R) along x and y over (y, x).
    """

    youngs_modulus_gpa: float
    poissons_ratio: float
    centre_px: Field
    frames: Mapping[str, TrueFrame]
    start_ns: int
    drift: CubicSpline
    distortion_px: tuple[RectBivariateSpline, RectBivariateSpline]

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Truth:
        """Truth from the content of a truth file.

        Raises:
            BadInput: a required value is missing.
        """
        try:
            frames = {
                entry["file"]: TrueFrame(
                    int(entry["start_time_ns"]), float(entry["row_time_s"]), np.asarray(entry["stage_px"]), np.asarray(entry["gradient"])
                )
                for entry in content["frames"]
            }
            drift, bend, start_ns = content["drift"], content["distortion"], int(content["start_time_ns"])
            time_s = (np.asarray(drift["time_ns"], dtype=np.int64) - start_ns) * 1e-9
            return cls(
                float(content["youngs_modulus_gpa"]),
                float(content["poissons_ratio"]),
                np.asarray(content["centre_px"], dtype=np.float64),
                frames,
                start_ns,
                CubicSpline(time_s, np.stack((drift["dx_px"], drift["dy_px"]), axis=1)),
                (_surface(bend, "ex_px"), _surface(bend, "ey_px")),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"the truth file is incomplete ({error}); give the truth.json that the simulator wrote") from error

    def frame(self, name: str) -> TrueFrame:
        """The truth of one frame.

        Raises:
            BadInput: the truth contains no such file.
        """
        if name not in self.frames:
            raise BadInput(f"the truth contains no frame {name}; give the truth.json of this run")
        return self.frames[name]

    def drift_at(self, frame: TrueFrame, time_s: ArrayLike) -> Field:
        """(..., 2) drift in px at seconds since a frame's scan began."""
        return np.asarray(self.drift((frame.start_ns - self.start_ns) * 1e-9 + np.asarray(time_s)))

    def distortion_at(self, address_px: Field) -> Field:
        """(..., 2) distortion E in px at scan addresses (..., 2)."""
        return np.stack([spline.ev(address_px[..., 1], address_px[..., 0]) for spline in self.distortion_px], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class TrueMotion:
    """True motion of points of frame 0 in another frame.

    Attributes:
        displacement_px: (..., 2) displacement of the specimen from frame 0, without drift and distortion.
        correction_px: (..., 2) contribution of drift and distortion: ``[E(R_n) + d_n] - [E(R_0) + d_0]``.
    """

    displacement_px: Field
    correction_px: Field


def true_motion(truth: Truth, first: FrameInfo, info: FrameInfo, address_px: Field) -> TrueMotion:
    """Track the material points at scan addresses (..., 2) of frame 0 to another frame.

    The beam at address R is at ``p = R - E(R) - d(t(R))`` and scans the material point with ``p = xi + s + G (xi - c)``.
    With M integrated scans the result is the mean over the scans.
    """
    before, after = truth.frame(first.name), truth.frame(info.name)
    bent_px = truth.distortion_at(address_px) + _drift_of(truth, first, address_px)
    centre = truth.centre_px
    position = address_px - bent_px - centre
    material = (position - before.shift_px) @ np.linalg.inv(np.eye(2) + before.gradient).T
    moved = after.shift_px + material @ (np.eye(2) + after.gradient).T
    reached = address_px + moved - position
    for _ in range(_REFINEMENTS):
        reached = centre + moved + truth.distortion_at(reached) + _drift_of(truth, info, reached)
    return TrueMotion(moved - position, reached - centre - moved - bent_px)


def average_over_subset(value: Callable[[Field], Field], address_px: Field, subset_px: int) -> Field:
    """The mean of a field over the subset about each address (..., 2), by three Gauss points along each axis.

    A correlation with an affine shape function measures this mean of a field that is curved within the subset. It differs from the field by
    up to 0.02 px at the largest curvature of a distortion like that in Fig. 11 of Sutton et al. (2007).
    """
    points = [(0.5 * root * subset_px, 0.5 * weight) for root, weight in zip(*np.polynomial.legendre.leggauss(3), strict=True)]
    means = [wx * wy * value(address_px + np.array([x, y])) for x, wx in points for y, wy in points]
    return np.asarray(np.sum(means, axis=0))


def strain_gradient(truth: Truth, first: FrameInfo, info: FrameInfo) -> Field:
    """(2, 2) true displacement gradient of a frame relative to frame 0."""
    before, after = np.eye(2) + truth.frame(first.name).gradient, np.eye(2) + truth.frame(info.name).gradient
    return np.asarray(after @ np.linalg.inv(before) - np.eye(2))


def load_truth(path: Path) -> dict[str, Any]:
    """Read the truth file of a simulator.

    Raises:
        BadInput: the file is missing or is not a truth file.
    """
    try:
        truth = parse_json(read_regular(path, _MOST_BYTES))
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: is not a truth file ({error}); give the truth.json that the simulator wrote") from error
    if not isinstance(truth, dict) or truth.get("version") != 1:
        raise BadInput(f"{path}: is not a truth file of version 1; give the truth.json that the simulator wrote")
    return truth


def _drift_of(truth: Truth, info: FrameInfo, address_px: Field) -> Field:
    """(..., 2) drift of a frame at scan addresses, mean over its integrated scans."""
    frame, timing = truth.frame(info.name), info.timing
    dwell_s, scan_s = timing.dwell_time_s.value, timing.frame_time_s.value
    sampled_s = np.linspace(-0.1 * scan_s, 1.1 * scan_s, _VISITS)
    visits_s = scan_s * np.arange(timing.integrations.value)
    mean_px = truth.drift_at(frame, sampled_s[:, None] + visits_s).mean(axis=1)
    return np.asarray(CubicSpline(sampled_s, mean_px)(address_px[..., 0] * dwell_s + address_px[..., 1] * frame.row_time_s))


def _surface(bend: Mapping[str, Any], name: str) -> RectBivariateSpline:
    return RectBivariateSpline(np.asarray(bend["y_px"]), np.asarray(bend["x_px"]), np.asarray(bend[name]))
