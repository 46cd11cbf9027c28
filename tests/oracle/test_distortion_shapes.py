"""Named distortions agree with the paper's Fig. 11: their ranges, and the effect of a translation by 5 px (Fig. 16)."""

from __future__ import annotations

import numpy as np
import pytest

from semlive_simulators.effects.distortion import SHAPES
from semlive_simulators.scenario import BadScenario, load_scenario

RANGES_PX = {"fig11_x200": ((-0.6, 1.0), (-0.5, 2.0)), "fig11_x10000": ((-0.5, 0.5), (-0.4, 2.6))}
STRAIN_ERRORS = {"exx": (-1.5e-4, 1.0e-4), "exy": (-3.3e-4, 4.3e-4), "eyy": (-4.0e-4, 6.0e-4)}
GRID_PX = np.meshgrid(np.arange(101.0, 847.0, 5.0), np.arange(101.0, 697.0, 5.0))


def strain_errors(name: str, shift_px: float) -> dict[str, np.ndarray]:
    def moved(dx_px: float, dy_px: float) -> np.ndarray:
        x_px, y_px = GRID_PX[0] + dx_px, GRID_PX[1] + dy_px
        return SHAPES[name].at(x_px + shift_px, y_px + shift_px, 1024, 884) - SHAPES[name].at(x_px, y_px, 1024, 884)

    along_x = (moved(0.5, 0) - moved(-0.5, 0)) / 1.0
    along_y = (moved(0, 0.5) - moved(0, -0.5)) / 1.0
    return {"exx": along_x[..., 0], "exy": 0.5 * (along_y[..., 0] + along_x[..., 1]), "eyy": along_y[..., 1]}


@pytest.mark.parametrize("name", SHAPES)
def test_ranges_are_the_papers(name: str) -> None:
    bend = SHAPES[name].at(*GRID_PX, 1024, 884)
    for axis, (low, high) in enumerate(RANGES_PX[name]):
        assert bend[..., axis].min() == pytest.approx(low, abs=0.01)
        assert bend[..., axis].max() == pytest.approx(high, abs=0.01)


@pytest.mark.parametrize("name", SHAPES)
def test_a_translation_makes_the_papers_strain_errors_of_them(name: str) -> None:
    errors = strain_errors(name, 5.0)
    for component, (low, high) in STRAIN_ERRORS.items():
        assert errors[component].min() == pytest.approx(low, rel=0.03)
        assert errors[component].max() == pytest.approx(high, rel=0.03)
    # "The maximum exceeding 1e-3 for an 8 pixel translation": strain errors grow in proportion, so that 6e-4 at 5 px make 9.5e-4.
    assert strain_errors(name, 8.0)["eyy"].max() > 9e-4


def test_rows_settle_along_x_and_frames_settle_along_y() -> None:
    for shape in SHAPES.values():
        for axis in (shape.x, shape.y):
            assert axis.left_px != 0
            assert axis.top_px != 0
    x_px = np.array([0.0, 0.12 * 1023, 1023.0])
    axis = SHAPES["fig11_x10000"].y
    X = 2 * x_px / 1023 - 1
    settling = axis.left_px * np.exp(-(X + 1) / (2 * axis.left_reach))
    np.testing.assert_allclose(settling[:2], [0.5, 0.5 / np.e], rtol=1e-12)


def test_a_scenario_names_a_shape_and_an_unknown_name_is_refused(tmp_path) -> None:
    assert load_scenario("paper_x10000").distortion == SHAPES["fig11_x10000"]
    assert load_scenario("paper_x200_fig11").distortion == SHAPES["fig11_x200"]
    path = tmp_path / "odd.yaml"
    path.write_text("extends: paper_x200\ndistortion: fig12\n")
    with pytest.raises(BadScenario, match=r"distortion: .*no distortion fig12; choose fig11_x200"):
        load_scenario(str(path))
