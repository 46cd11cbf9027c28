"""Faults 26 to 41: what the microscope exports, and the folder into which it does."""

from __future__ import annotations

import time
from typing import Any

import cv2
import numpy as np
from lab import Lab, until
from table import Kind, Observation, Row

from semlive_simulators.exporters.settings import Vendor


def ready(lab: Lab, **sem: Any) -> Lab:
    """A run of one step without a load frame, waiting for its two frames."""
    lab.no_frame()
    lab.config["sem"] |= sem
    lab.start().reach("imaging")
    time.sleep(0.6)  # the hold is over by more than the uncertainty of a start
    return lab


def refusal(lab: Lab, name: str, says: str, within_s: float = 60.0) -> str:
    """The one refusal of a file, with its reason."""

    def found() -> list[str]:
        return [entry["reason"] for entry in lab.logged("/sem/file") if entry["name"] == name and entry["decision"] == "refused"]

    until(found, f"{name} is refused", within_s)
    reasons = found()
    assert len(reasons) == 1, reasons
    assert says in reasons[0], reasons
    return reasons[0]


def goes_on(lab: Lab, frames: int = 2) -> None:
    """Good frames complete the pair, and the run ends as it should."""
    for _ in range(frames):
        lab.frame()
        time.sleep(0.5)
    code, output = lab.end()
    assert code == 0, output
    assert [entry["pair"] for entry in lab.logged("/pair")] == [0]
    lab.require_complete_log()


def originals(lab: Lab) -> int:
    return len([entry for entry in lab.logged("/sem/file") if entry["decision"] == "accepted"])


def truncated(lab: Lab) -> Observation:
    ready(lab)
    data, _ = lab.picture()
    (lab.export / "cut.tif").write_bytes(data[: round(len(data) * 0.9999)])
    reason = refusal(lab, "cut.tif", "never became complete")
    goes_on(lab)
    return Observation(reason)


def preallocated(lab: Lab) -> Observation:
    ready(lab, vendor="zeiss", profile={"start_sigma_s": 0.01, "databar_rows": 20})
    data, _ = lab.picture(vendor=Vendor.ZEISS)
    never = data[: len(data) // 2] + bytes(len(data) - len(data) // 2)
    (lab.export / "never.tif").write_bytes(never)
    reason = refusal(lab, "never.tif", "never became complete")
    for _ in range(5):
        path = lab.export / f"late_{lab.frames}.tif"
        path.write_bytes(bytes(len(never)))
        time.sleep(1.3)
        data, _ = lab.picture(vendor=Vendor.ZEISS)
        path.write_bytes(data)
        lab.frames += 1
        time.sleep(0.7)
        if lab.logged("/pair"):
            break
    code, output = lab.end()
    assert code == 0, output
    assert len(lab.logged("/pair")) == 1
    lab.require_complete_log()
    return Observation(f"{reason} Two that were filled 1.3 s later were taken")


def sidecar(lab: Lab) -> Observation:
    times = {"row_time_s": 9e-4, "dwell_time_s": 3e-6, "frame_time_s": 0.2, "start_sigma_s": 0.01}
    ready(lab, vendor="jeol", sidecar_timeout_s=2.0, profile=times)
    never, _ = lab.picture(vendor=Vendor.JEOL)
    (lab.export / "never.tif").write_bytes(never)
    reason = refusal(lab, "never.tif", "never got the text file")
    for number in range(3):
        time.sleep(1.1)
        data, text = lab.picture(vendor=Vendor.JEOL)
        assert text is not None
        path = lab.export / f"late_{number}.tif"
        path.write_bytes(data)
        time.sleep(1.0)
        path.with_suffix(".txt").write_bytes(text)
        lab.frames += 1
        if lab.daemon.poll() is not None:
            break
    until(lambda: lab.logged("/pair"), "the pair is complete")
    assert lab.end()[0] == 0
    lab.require_complete_log()
    return Observation(f"{reason} Those whose text came 1 s late were taken with it")


def overwritten(lab: Lab) -> Observation:
    ready(lab)
    path = lab.frame("same.tif")
    until(lambda: lab.logged("/sem/scan"), "the first is taken")
    data, _ = lab.picture()
    path.write_bytes(data)
    reason = refusal(lab, "same.tif", "was overwritten")
    time.sleep(0.5)  # the next scan begins after this one
    goes_on(lab, 1)
    return Observation(reason)


def counters(lab: Lab) -> Observation:
    ready(lab)
    lab.frame("img_0007.tif", ago_s=60.0)
    until(lambda: lab.logged("/sem/scan"), "the first is taken")
    lab.frame("img_0011.tif", ago_s=55.0)
    time.sleep(0.7)
    lab.frame("img_0001.tif", ago_s=50.0)
    until(lambda: "img_0001" in lab.reported() and "img_0011" in lab.reported(), "gap and restart are reported")
    goes_on(lab)
    reports = [entry["text"] for entry in lab.logged("/log") if "img_00" in entry["text"]]
    return Observation("; ".join(reports)[:220])


def frozen(lab: Lab) -> Observation:
    ready(lab)
    path = lab.frame("one.tif")
    until(lambda: lab.logged("/sem/scan"), "the first is taken")
    (lab.export / "two.tif").write_bytes(path.read_bytes())
    reason = refusal(lab, "two.tif", "holds the same bytes")
    goes_on(lab, 1)
    return Observation(reason)


def before_hold_end(lab: Lab) -> Observation:
    lab.no_frame()
    lab.config["protocol"]["hold_s"] = 3.0
    lab.start().reach("holding")
    time.sleep(0.5)
    lab.frame("early.tif")
    until(lambda: any("early.tif is not used" in entry["reason"] for entry in lab.logged("/sem/file")), "it is refused")
    reason = next(entry["reason"] for entry in lab.logged("/sem/file") if "early.tif is not used" in entry["reason"])
    lab.reach("imaging")
    time.sleep(0.6)
    goes_on(lab)
    return Observation(reason)


def one_or_three(lab: Lab) -> Observation:
    lab.no_frame()
    lab.config["protocol"] |= {"frame_timeout_s": 6.0}
    lab.start(attended=True).reach("imaging")
    time.sleep(0.6)
    lab.frame()
    lab.reach("fault")
    assert not lab.logged("/pair")
    lab.enter("resume")
    lab.reach("recover").enter("resume")
    lab.reach("imaging", 2)
    time.sleep(0.6)
    lab.frame()
    time.sleep(0.4)
    data, _ = lab.picture()
    lab.frames += 1
    third, _ = lab.picture(ago_s=-0.3)
    (lab.export / "second.tif").write_bytes(data)
    time.sleep(0.3)
    (lab.export / "third.tif").write_bytes(third)
    code, output = lab.end()
    assert code == 0, output
    (pair,) = lab.logged("/pair")
    assert pair["second"]["name"] == "second.tif"
    lab.require_complete_log()
    return Observation(
        "one frame: fault after frame_timeout_s, no pair; then three: the first two are the pair, the third is recorded and not used"
    )


def other_settings(lab: Lab) -> Observation:
    ready(lab)
    lab.frame("a.tif")
    time.sleep(0.5)
    lab.frame("b.tif", size=(300, 221))
    until(lambda: any("instead of" in entry["reason"] for entry in lab.logged("/sem/file")), "the difference is reported")
    reason = next(entry["reason"] for entry in lab.logged("/sem/file") if "instead of" in entry["reason"])
    time.sleep(0.3)
    lab.frame("c.tif", size=(300, 221))
    code, output = lab.end()
    assert code == 0, output
    (pair,) = lab.logged("/pair")
    assert (pair["first"]["name"], pair["second"]["name"]) == ("b.tif", "c.tif")
    lab.require_complete_log()
    return Observation(reason)


def kinds_of_pixels(lab: Lab) -> Observation:
    reports = {"row_time_s": 8e-4, "dwell_time_s": 2e-6, "frame_time_s": 0.2, "start_sigma_s": 0.01, "pixel_size_m": 1e-6}
    ready(lab, profile=reports)
    chance = np.random.default_rng(3)
    grey = np.kron(chance.integers(20, 230, (80, 90), dtype=np.uint8), np.ones((3, 3), dtype=np.uint8))
    made = {
        "colour.tif": np.stack([grey, np.roll(grey, 5), grey], axis=-1),
        "grey_as_rgb_lzw.tif": np.stack([grey] * 3, axis=-1),
        "sixteen.tif": grey.astype(np.uint16) * 250,
        "sixteen_more.tif": np.roll(grey, 1).astype(np.uint16) * 250,
    }
    for name, picture in made.items():
        compression = cv2.IMWRITE_TIFF_COMPRESSION_LZW if "lzw" in name else cv2.IMWRITE_TIFF_COMPRESSION_NONE
        _, encoded = cv2.imencode(".tif", picture, [cv2.IMWRITE_TIFF_COMPRESSION, compression])
        working = lab.export / f"{name}.tmp"
        working.write_bytes(encoded.tobytes())
        working.replace(lab.export / name)
        time.sleep(0.8)
    refused = [entry for entry in lab.logged("/sem/file") if entry["name"] == "colour.tif" and entry["decision"] == "refused"]
    until(lambda: lab.logged("/pair"), "16 bit and LZW are the pair")
    (pair,) = lab.logged("/pair")
    names = {pair["first"]["name"], pair["second"]["name"]}
    assert "colour.tif" not in names, names
    assert refused, lab.logged("/sem/file")
    assert lab.end()[0] == 0
    lab.require_complete_log()
    return Observation(f"{refused[0]['reason']} Grey as RGB with LZW, and 16 bit, were taken")


def mid_scan(lab: Lab) -> Observation:
    ready(lab, vendor="zeiss", profile={"start_sigma_s": 0.01, "databar_rows": 20})
    for number in range(6):
        time.sleep(1.2)
        data, _ = lab.picture(vendor=Vendor.ZEISS, line_passes=2)
        for whole, busy in (
            ("Line Int. Done", "Line Int. Busy"),
            ("Image = Frozen", "Image = Live  "),
            ("Line Counter = 0     ", "Line Counter = 150   "),
        ):
            assert whole.encode() in data
            data = data.replace(whole.encode(), busy.encode()).replace(whole.encode("utf-16-le"), busy.encode("utf-16-le"))
        working = lab.export / f"z_{number}.tmp"
        working.write_bytes(data)
        working.replace(lab.export / f"z_{number}.tif")
        lab.frames += 1
        if lab.logged("/pair"):
            break
    until(lambda: lab.logged("/pair"), "a pair")
    code, output = lab.end()
    assert code == 0, output
    (pair,) = lab.logged("/pair")
    assert (pair["first"]["height_px"], pair["second"]["height_px"]) == (150, 150)
    lab.require_complete_log()
    return Observation("both counted down to row 150, which they had reached; a pair of 150 rows")


def share_gone(lab: Lab) -> Observation:
    ready(lab)
    lab.frame()
    until(lambda: lab.logged("/sem/scan"), "the first is taken")
    away = lab.folder / "away"
    lab.export.rename(away)
    until(lambda: "cannot be read" in lab.reported(), "that the folder is gone is reported")
    away.rename(lab.export)
    until(lambda: "is back" in lab.reported(), "that its return is reported")
    goes_on(lab, 1)
    assert len(lab.logged("/sem/scan")) == 2
    return Observation("reported: the export folder cannot be read, it is tried again; reported when it was back; nothing was taken twice")


def wrong_clock(lab: Lab) -> Observation:
    ready(lab)
    for _ in range(2):
        lab.frame(clock_s=3600.0)
        time.sleep(0.7)
    until(lambda: any(entry.get("advice") for entry in lab.logged("/clock/offset")), "the offset is reported")
    advice = next(entry["advice"] for entry in lab.logged("/clock/offset") if entry.get("advice"))
    time.sleep(0.5)
    assert not lab.logged("/pair"), "frames of a clock that is an hour ahead made a pair"
    refused = [entry["reason"] for entry in lab.logged("/sem/file") if "after it arrived" in entry["reason"]]
    assert len(refused) == 2
    lab.frame(clock_s=-3600.0)
    until(lambda: sum("is not used" in entry["reason"] for entry in lab.logged("/sem/file")) == 3, "the late one is refused")
    goes_on(lab)
    return Observation(f"{advice} Frames an hour ahead and behind made no pair")


def old_files(lab: Lab) -> Observation:
    for number in range(10_000):
        (lab.export / f"old_{number:05d}.tif").write_bytes(b"II*\0old")
    ready(lab)
    goes_on(lab)
    names = {entry["name"] for entry in lab.logged("/sem/file")}
    assert not [name for name in names if name.startswith("old_")]
    return Observation("none was read or refused; the pair was taken")


def hopeless(lab: Lab) -> Observation:
    ready(lab)
    _pair(lab, contrast=0.0)
    code, output = lab.end()
    lab.require_complete_log()
    assert code == 1, output
    assert "the first pair cannot be used" in output, output
    assert not [entry for entry in lab.logged("/result") if entry["pairs"]]
    later = Lab(lab.folder / "later", lab.stand)
    try:
        later.no_frame([[0.0, 0.0]] * 3)
        later.config["protocol"]["hold_s"] = 6.0
        later.start()
        for step, contrast in enumerate((1.0, 0.0)):
            later.reach("imaging", step + 1)
            time.sleep(0.6)
            _pair(later, contrast=contrast)
        code, output = later.end()
        assert code == 1, output
        assert later.states()[-3:] == ["fault", "stopping", "aborted"], later.states()
        assert len(later.logged("/pair")) == 2
        what = later.logged("/fault")[-1]["what"]
        assert "a pair cannot be used" in what, later.logged("/fault")
    finally:
        later.close()
    return Observation(f"in the only step: exit code 1, the first pair cannot be used; in the second of three steps, fault: {what}")


def _pair(lab: Lab, contrast: float) -> None:
    for _ in range(2):
        lab.frame(contrast=contrast)
        time.sleep(0.5)


def held_open(lab: Lab) -> Observation:
    raise NotImplementedError


R, E = Kind.REAL, Kind.EMULATED
ROWS = (
    Row(26, "a file cut at 99.99 %", "refused once, with the reason; the run continues", R, truncated),
    Row(
        27, "a file at full size, half zeros; another filled 1.3 s later", "the first refused, the second taken completely", R, preallocated
    ),
    Row(28, "the text file of an image arrives late, or never", "taken with it, or refused", R, sidecar),
    Row(29, "a file is overwritten under its name", "reported; never taken twice", R, overwritten),
    Row(30, "numbers in names jump and start again", "reported; the run continues", R, counters),
    Row(31, "the same frame twice", "refused", R, frozen, short=True),
    Row(32, "a frame scanned before the hold ended", "recorded, refused with the reason", R, before_hold_end),
    Row(33, "one frame only; then three", "fault without a pair; two of three are the pair", R, one_or_three),
    Row(34, "another size within a pair", "refused by name; the pair is of one kind", R, other_settings),
    Row(35, "colour, grey as RGB with LZW, 16 bit", "colour refused, the others taken", R, kinds_of_pixels),
    Row(36, "Zeiss files saved in the middle of a scan", "used down to the row that was reached", R, mid_scan),
    Row(37, "the export folder goes away and comes back", "reported; nothing lost, nothing taken twice", R, share_gone),
    Row(38, "the SEM's clock an hour ahead, then an hour behind", "reported with advice; no pair from such frames", R, wrong_clock),
    Row(39, "10,000 old files in the folder", "none of them is touched", R, old_files),
    Row(40, "a virus scanner, an indexer or the SEM's own program holds a file", "waited for, not refused", Kind.WINDOWS, held_open),
    Row(
        41,
        "frames without contrast",
        "the pair cannot be used: fault if steps are left, else the run ends as failed; no result from it",
        R,
        hopeless,
    ),
)
