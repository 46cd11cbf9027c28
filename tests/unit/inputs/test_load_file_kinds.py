"""Load files as testing programs of many vendors and countries write them: 134.2 N and 0.5 mm, or refused with the true reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from semlive.data.checks import Verdict
from semlive.errors import LinkError
from semlive_drivers.load_file.check import check_load_file
from semlive_drivers.load_file.part import CsvLoadFile, CsvSettings

from ...clocks import HandClock


def utf8(text: str) -> bytes:
    return text.encode()


ROWS = "0,1;134,2;0,5\n0,2;134,2;0,5\n"
READ: dict[str, tuple[bytes, str, str]] = {
    "Instron, German": (f"Zeit;Kraft;Verlängerung\n(s);(N);(mm)\n{ROWS}".encode("cp1252"), "Kraft", "Verlängerung"),
    "Instron, quoted": (
        b'"Results Table 1"\n"Time","Extension","Load"\n"(s)","(mm)","(kN)"\n"0.100","0.5000","0.1342"\n', "Load", "Extension"
    ),
    "Zwick, quoted names and units": (
        '"Prüfzeit"\t"Standardweg"\t"Standardkraft"\n"s"\t"mm"\t"kN"\n0,1\t0,5\t0,1342\n'.encode("cp1252"), "Standardkraft", "Standardweg"
    ),
    "MTS": (b"Time,Axial Displacement,Axial Force\nsec,mm,kN\n0.1,0.5,0.1342\n", "Axial Force", "Axial Displacement"),
    "MTS, preamble": (
        b"MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A\n\nData Acquisition\nTime\tAxial Displacement\tAxial Force\nSec\tmm\tN\n0.1\t0.5\t134.2\n",
        "Axial Force", "Axial Displacement",
    ),
    "Shimadzu": (b'"Name","Time","Force","Stroke"\n"","sec","N","mm"\n"1 _ 1","0.1","134.2","0.5"\n', "Force", "Stroke"),
    "LabVIEW measurement": (
        b"Separator\tTab\n***End_of_Header***\t\n\t\t\t\nX_Value\tForce\tExt\tComment\n0.1\t134.2\t0.5\t\n", "Force", "Ext"
    ),
    "LabVIEW, decimal comma, three digits": (b"Time\tForce\tExt\r\n0,100\t134,200\t0,500\r\n", "Force", "Ext"),
    "Deben": (b"Microtest Data File\nDate,26/11/2026\nTime (s),Force (N),Ext (mm)\n1,134.2,0.5\n", "Force", "Ext"),
    "Kammrath & Weiss, unit behind a slash": (b"# Kammrath & Weiss\n# t/s\tF/kN\ts/mm\n0.1\t0.1342\t0.5\n", "F", "s"),
    "unit behind a slash with blanks": (utf8(f"Zeit / s;Kraft / N;Weg / mm\n{ROWS}"), "Kraft", "Weg"),
    "unit behind 'in'": (b"Zeit in s;Kraft in kN;Weg in mm\n0,1;0,1342;0,5\n", "Kraft", "Weg"),
    "unit behind an underscore": (b"time_s,force_kN,ext_um\n0.1,0.1342,500\n", "force_kN", "ext_um"),
    "unit behind a blank": (b"Time s,Force kN,Ext mm\n0.1,0.1342,0.5\n", "Force kN", "Ext mm"),
    "unit behind a colon": (b"Time: s,Force: kN,Ext: mm\n0.1,0.1342,0.5\n", "Force", "Ext"),
    "unit in braces": (b"Time {s},Force {kN},Ext {mm}\n0.1,0.1342,0.5\n", "Force", "Ext"),
    "unit in angle brackets": (b"Time <s>;Force <kN>;Ext <mm>\n0,1;0,1342;0,5\n", "Force", "Ext"),
    "brackets of full width": (utf8("时间（s）,力（kN）,位移（mm）\n0.1,0.1342,0.5\n"), "力", "位移"),
    "micrometres of the western code page": (f"Time;Force;Ext [µm]\n{ROWS.replace('0,5', '500')}".encode("cp1252"), "Force", "Ext"),
    "micrometres of the Japanese code page": (f"Time;Force;Ext [μm]\n{ROWS.replace('0,5', '500')}".encode("cp932"), "Force", "Ext"),
    "decanewtons": (b"Time;Force [daN];Ext\n0,1;13,42;0,5\n", "Force", "Ext"),
    "capital units": (utf8(f"Time [SEC];Force [NEWTON];Ext [MM]\n{ROWS}"), "Force", "Ext"),
    "UTF-16 without a mark": ("Time\tForce\tExt\n0,1\t134,2\t0,5\n".encode("utf-16-le"), "Force", "Ext"),
    "UTF-16 with a sep line": ("\ufeffsep=\t\r\nTime\tForce\tExt\r\n0,1\t134,2\t0,5\r\n".encode("utf-16-le"), "Force", "Ext"),
    "typographic minus": (utf8("Time;Force;Ext\n−0,1;134,2;0,5\n"), "Force", "Ext"),
    "exponents of Fortran": (b"Time Force Ext\n0.1 1.342D+02 5.0D-01\n", "Force", "Ext"),
    "date and time in one cell": (b"Date Time;Force;Ext\n26.11.2026 12:00:00,1;134,2;0,5\n", "Force", "Ext"),
    "separator at the end of each line": (b"Time;Force;Ext;\n0,1;134,2;0,5;\n", "Force", "Ext"),
    "columns of fixed width": (b"   Time,   Force,     Ext\n  0.100, 134.200,   0.500\n", "Force", "Ext"),
    "line ends doubled": (b"Time,Force,Ext\r\r\n0.1,134.2,0.5\r\r\n", "Force", "Ext"),
    "micronewtons": (b"Time_s\tForce_uN\tExt_um\n0.1\t134200000\t500\n", "Force", "Ext"),
    "a unit that is a dash": (b"Index;Force;Ext\n-;kN;mm\n1;0,1342;0,5\n", "Force", "Ext"),
    "a unit that is one": (b"Index;Force;Ext\n[1];[kN];[mm]\n1;0,1342;0,5\n", "Force", "Ext"),
    "units above the names": (b"s;kN;mm\nTime;Force;Ext\n0,1;0,1342;0,5\n", "Force", "Ext"),
    "a line of channels above the units": (b"Time;Force;Ext\nCH1;CH2;CH3\ns;kN;mm\n0,1;0,1342;0,5\n", "Force", "Ext"),
    "names twice": (utf8(f"Time;Force;Ext\nTime;Force;Ext\n{ROWS}"), "Force", "Ext"),
    "names of full width": (utf8(f"Ｔｉｍｅ;Ｆｏｒｃｅ;Ｅｘｔ\n{ROWS}"), "Force", "Ext"),
    "a remark that begins like an error value": (utf8(f"#Number of channels: 3\nTime;Force;Ext\n{ROWS}#Reference\n"), "Force", "Ext"),
    "row names of R": (b'"Time" "Force" "Ext"\n"1" 0.1 133.1 0.4\n"2" 0.2 134.2 0.5\n', "Force", "Ext"),
    "units with full names": (utf8("Time;Force [kilonewtons];Ext [microns]\n0,1;0,1342;500\n"), "Force", "Ext"),
    "units of Russia": (utf8("Время;Сила, кН;Ход, мм\n0,1;0,1342;0,5\n").replace(b", ", b" / "), "Сила", "Ход"),
    "numbers of channels": (
        b"Scan,Time,101 <Force> (N),Alarm 101,102 <Ext> (mm),Alarm 102\n1,11/27/2026 10:15:30:123 PM,134.2,0,0.5,0\n",
        "101 <Force>", "102 <Ext>",
    ),
    "a unit in each line": (b"Force;Unit;Ext\n134.1;N;0.4\n134.2;N;0.5\n", "Force", "Ext"),
    "names and units repeated": (b"Time;Force;Ext\ns;kN;mm\n0,1;9;9\nTime;Force;Ext\ns;kN;mm\n0,1;0,1342;0,5\n", "Force", "Ext"),
    "brackets of Japan": (utf8("時間【s】;荷重【kN】;変位「mm」\n0,1;0,1342;0,5\n"), "荷重", "変位"),
    "a legend in N": (utf8(f"Ch2: Force [N], 5 kN load cell\nPreload: 0.01 kN, 0.1 kN/s\n# kN-steel\nTime;Force;Ext\n{ROWS}"),
        "Force", "Ext",
    ),
    "half a line at the end": (b"Time,Force,Ext\n0.1,134.2,0.5\n0.2,9", "Force", "Ext"),
}  # fmt: skip
REFUSED: dict[str, tuple[bytes, str]] = {
    "commas": (b"Time,Force,Ext\n12,4,134,2,0,5\n", "has 6 cells under 3 names: the numbers seem to have decimal commas"),
    "unknown unit in brackets": (b"Time;Force [tonf];Ext\n0,1;13,42;0,5\n", "is in 'tonf', which is not known; state its unit"),
    "unit unknown": (b"Time;Force;Ext\nSekunden;Kilopond;mm\n0,1;13,42;0,5\n", "is in 'Kilopond', which is not known; state its unit"),
    "volts": (b"Time (s),Force (V),Ext (mm)\n0.1,3.2,0.5\n", "is in 'V', which is not known"),
    "millinewtons or meganewtons": (b"Time;Force [MN];Ext\n0,1;0,13;0,5\n", "is in 'MN', which is not known"),
    "per cent as extension": (b"Time;Force;Ext [%]\n0,1;134,2;0,5\n", "is in %, which is no unit of extension"),
    "thousands of the USA": (b'Time,Force,Ext\n0.1,"1,134.20",0.5\n', "switch the separator of thousands off"),
    "thousands of France": (utf8("Temps;Force;Ext\n0,1;1\u202f134,2;0,5\n"), "switch the separator of thousands off"),
    "thousands of Switzerland": (utf8("Zeit;Force;Ext\n0.1;1’134.2;0.5\n"), "switch the separator of thousands off"),
    "thousands of India": (b'Time,Force,Ext\n0.1,"1,13,134.2",0.5\n', "switch the separator of thousands off"),
    "three digits with two meanings": (b"Force;Ext\n134,200;1,500\n", "'134,200' may mean 134.200 or 134200"),
    "a lost value": (b"Time,Force,Ext\n0.1,-nan(ind),0.5\n", "holds '-nan(ind)' in column Force, which is no reading but a lost value"),
    "an overload": (b"Time,Force,Ext\n0.1,OVL,0.5\n", "holds 'OVL' in column Force, which is no reading"),
    "units in the cells": (b"Time,Force,Ext\n0.1 s,134.2 N,0.5 mm\n", "may mean '134.2 N' and '0.5 mm'"),
    "two columns of one name": (b"Time,Force,Force,Ext\n0.1,134.2,1.2,0.5\n", "column 'Force' exists 2 times"),
    "a name over two lines": (b'Time,"Force\nN",Ext\n0.1,134.2,0.5\n', "line 1: its quotes are broken"),
    "digits with underscores": (b"Time,Force,Ext\n0.1,1_342,0.5\n", "holds '1_342' in column Force, which is no reading"),
    "hexadecimal": (b"Time,Force,Ext\n0.1,0x86,0.5\n", "holds '0x86' in column Force, which is no reading"),
    "minus behind the number": (b"Time;Force;Ext\n0,1;134,2-;0,5\n", "holds '134,2-' in column Force, which is no reading"),
    "an error value": (b"Time;Force;Ext\n0,3;#NUM!;0,5\n", "line 2 holds '#NUM!' in column Force, which is no reading but a lost value"),
    "an error value at the beginning": (b"Force;Ext\n134,2;0,5\n#VALEUR!;0,5\n", "line 3 holds '#VALEUR!' in column Force"),
    "a column too narrow": (b"Force;Ext\n134,2;0,5\n####;0,5\n", "line 3 holds '####' in column Force"),
    "two units": (b"Time;Force [kN];Ext\ns;N;mm\n0,1;0,1342;0,5\n", "is in 'kN and N', which is not known"),
    "a factor below the names": (b"No;Force;Ext\n1;10^3 N;mm\n1;0,1342;0,5\n", "line 2: '10^3 N' below the names is neither a number nor"),
    "a summary": (utf8(f"Time;Force;Ext\n{ROWS}Mean;99,9;0,5\n"), "line 4 begins with 'Mean' and not with a number"),
    "a name that may end in a unit": (b"Time;Force;Ext_in\n0,1;134,2;0,5\n", "there is no column 'Ext'"),
    "tonnes or time": (b"Time;Force (t);Ext\n0,1;134,2;0,5\n", "column 'Force (t)' may be in 't'; state its unit in the settings"),
    "a unit in a title": (b"Force unit: kN\nTime;Force;Ext\n0,1;0,1342;0,5\n", "column 'Force' has no unit, but line 1 states 'kN'"),
    "a unit in a list of the columns": (b"# 1: Time [s]\n# 2: Force [kN]\nTime;Force;Ext\n0,1;0,1342;0,5\n", "but line 2 states 'kN'"),
    "no value of an instrument": (b"Force;Ext\n134.2;0.5\n+9.91E+37;0.5\n", "which is no reading but a lost value"),
    "a unit of each channel": (
        b"Separator\tTab\nY_Unit_Label\tkN\tmm\t\n***End_of_Header***\nTime\tForce\tExt\n0.1\t0.1342\t0.5\n",
        "but line 2 states 'kN'",
    ),
    "a unit in each line": (b"Force;Unit;Ext\n134.2;N;0.5\n0.1342;kN;0.5\n", "line 3 holds '0.1342' in column Force next to the unit kN"),
    "another unit below": (b"Time;Force;Ext\ns;N;mm\n0,1;9;9\ns;kN;mm\n0,1;0,1342;0,5\n", "holds 's;kN;mm' below other names or units"),
    "another order below": (b"Time;Force;Ext\n0,1;9;9\nTime;Ext;Force\n0,1;0,5;134,2\n", "holds 'Time;Ext;Force' below other names"),
    "one line that ends with a separator": (b'"Force"\t"Ext"\r\n"7.8"\t""\t\r\n', "has 3 cells under 2 names"),
    "one line with a cell too many": (b'"Force"\t"Ext"\n"7.8"\t134.2\t0.5\n', "has 3 cells under 2 names"),
    "a unit between the names": (b"Time Force kN\n0.1 134.2 0.5\n", "'kN' between the names may be the unit of column 'Force'"),
    "a unit unknown in each line": (b"Force;Unit;Ext\n0.1342;klbf;0.5\n", "next to 'klbf', which may be its unit"),
    "a number of nines": (b"Time;Force;Ext\n0,1;-9999;0,5\n", "holds '-9999' in column Force, which is no reading but a lost value"),
    "six nines": (b"Time;Force;Ext\n0.1;999.999;0.5\n", "which is no reading but a lost value"),
    "an extension that is lost": (b"Time;Force;Ext\n0.1;134.2;-32768\n", "'-32768' in column Ext, which is no reading but a lost value"),
    "an impossible load": (b"Time;Force;Ext\n0.1;1e+10;0.5\n", "which is no reading but a lost value"),
    "a cell missing": (b"Time,Force,Ext\n0.1,134.2\n", "has 2 cells under 3 names"),
}  # fmt: skip


def opened(path: Path, data: bytes, force: str = "Force", extension: str = "Ext") -> CsvLoadFile:
    path.write_bytes(data)
    return CsvLoadFile(
        CsvSettings.model_validate({"file": path, "force": {"column": force}, "extension": {"column": extension}}), HandClock(0)
    )


@pytest.mark.parametrize("name", READ)
def test_load_and_extension_are_read(name: str, tmp_path: Path) -> None:
    reading = opened(tmp_path / "load.csv", *READ[name]).read()
    assert (reading.force_n, reading.extension_mm) == (pytest.approx(134.2, rel=1e-12), pytest.approx(0.5, rel=1e-12))


@pytest.mark.parametrize("name", REFUSED)
def test_the_true_reason_is_reported(name: str, tmp_path: Path) -> None:
    data, reason = REFUSED[name]
    with pytest.raises(LinkError) as refused:
        opened(tmp_path / "load.csv", data).read()
    assert reason in str(refused.value)


@pytest.mark.parametrize("name", [*READ, *REFUSED])
def test_the_check_before_a_run_predicts_what_the_run_does(name: str, tmp_path: Path) -> None:
    data, force, extension = READ[name] if name in READ else (REFUSED[name][0], "Force", "Ext")
    path = tmp_path / "load.csv"
    path.write_bytes(data)
    settings = CsvSettings.model_validate({"file": path, "force": {"column": force}, "extension": {"column": extension}})
    finding = check_load_file("load_file", settings, HandClock(0))
    assert finding.verdict is (Verdict.OK if name in READ else Verdict.FAILED)
    assert ("force 134.2 N, extension 0.5 mm" if name in READ else REFUSED[name][1]) in finding.observation


@pytest.mark.parametrize("name", ["Force-kN", "kN Force", "ForcekN", "Force lb", "Load (kN) cell 1", "Force=kN"])
def test_a_unit_in_a_name_is_not_ignored(name: str, tmp_path: Path) -> None:
    """Kilonewtons were read as newtons."""
    with pytest.raises(LinkError, match=r"may be in '(kN|lb)'; state its unit"):
        opened(tmp_path / "load.csv", f"Time;{name};Ext\n0,1;0,1342;0,5\n".encode(), name)
    given = CsvSettings.model_validate({"file": tmp_path / "load.csv", "force": {"column": name, "unit": "kN"}})
    assert CsvLoadFile(given, HandClock(0)).read().force_n == pytest.approx(134.2)


OTHER_NAMES = """
Force/10N|Force x10 N|F*1e3|Load 10^3 N|Load 10³ N|Force 10 N|Force/100|Force e3|Force x10 (N)|Force (N)/10
Force thousand N|Force klbf|Force_tf
FkN|FORCEKN|荷重kN|荷重キロニュートン|力 千牛|Сила кгс
Force V|Force mV/V|Force counts|raw_force|Force % FS|Force ‰|Force kilo-newton|Force cN
"""


@pytest.mark.parametrize("name", OTHER_NAMES.strip().replace("\n", "|").split("|"))
def test_a_factor_or_another_unit_in_a_name_is_refused(name: str, tmp_path: Path) -> None:
    """Each was read as N."""
    with pytest.raises(LinkError, match=r"may be in '.+'; state its unit in the settings"):
        opened(tmp_path / "load.csv", f"Time\t{name}\tExt\n0.1\t134.2\t0.5\n".encode(), name)


LEGENDS = """
Channel 2 Force kN|Ch1: Load [kN]|Col 2 = Force, kN|Channel 2 kN|2) kN|y: kN|Kraft Einheit kN
荷重 kN|力【kN】|Сила, кН
Force in KN|kN|Force: klbf
Load kp|Force tf|Force daN|force mn|Force [μN]|Load: t|Force (10³ N)|Force x1000 N|Force/10 N|Force/N*10|Force scale 1000
Ch 2: V|Load counts
Load in percent|%FS of load|Force ‰|Units: s / kN / mm|Force; kilonewtons
"""


@pytest.mark.parametrize("legend", LEGENDS.strip().replace("\n", "|").split("|"))
@pytest.mark.parametrize("head", ["{}\n# 7\nTime\tForce\tExt\n", "Time\tForce\tExt\n# {}\n"])
def test_a_unit_in_a_legend_is_refused(legend: str, head: str, tmp_path: Path) -> None:
    """Each was read as N."""
    with pytest.raises(LinkError, match=r"column 'Force' has no unit, but line [12] states '.+'"):
        opened(tmp_path / "load.csv", (head.format(legend) + "0.1\t134.2\t0.5\n" * 4).encode())


@pytest.mark.parametrize("legend", ["Ext [um]", "Channel 3: µm", "Ext, %", "Ext in ustrain", "Col 3 Ext inch", "Ext x10 mm"])
def test_a_unit_of_extension_in_a_legend_is_refused(legend: str, tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="column 'Ext' has no unit, but line 1 states"):
        opened(tmp_path / "load.csv", f"{legend}\nTime\tForce\tExt\n0.1\t134.2\t0.5\n".encode())


@pytest.mark.parametrize("legend", ["10/12/2026 N", "Load cell 2 mV/V", "Mass 20 g", "E 210 kN/mm2", "C:/data/10/N/a.csv", "Fe-Mn 22"])
def test_a_quantity_above_the_names_is_no_unit(legend: str, tmp_path: Path) -> None:
    assert opened(tmp_path / "load.csv", f"{legend}\nTime\tForce\tExt\n0.1\t134.2\t0.5\n".encode()).read().force_n == 134.2


@pytest.mark.parametrize(
    ("head", "cell", "strain"),
    [
        ("Strain (um/m)", "1500", 1.5e-3),
        ("Strain [mm/mm]", "0.0015", 1.5e-3),
        ("Strain (-)", "0.0015", 1.5e-3),
        ("Strain (ustrain)", "9.91E+37", None),
        ("Strain (ustrain)", "9999999", None),
        ("Strain (ustrain)", "-9999", None),
        ("Strain counts", "0.15", "may be in 'counts'"),
        ("Strain", "1500", "which is no strain; state its unit"),
        ("Strain_%", "0.15", "may be in '%'; state its unit"),
    ],
)
def test_a_gage_is_read_in_its_unit_or_refused(head: str, cell: str, strain: float | str | None, tmp_path: Path) -> None:
    path = tmp_path / "gage.csv"
    path.write_text(f"Force;{head}\n134.2;{cell}\n", encoding="utf-8")
    column = head if head in ("Strain_%", "Strain counts") else "Strain"
    settings = CsvSettings.model_validate({"file": path, "force": {"column": "Force"}, "gage": {"column": column}})
    if isinstance(strain, str):
        with pytest.raises(LinkError, match=strain):
            CsvLoadFile(settings, HandClock(0)).read()
    else:
        assert CsvLoadFile(settings, HandClock(0)).read().gage_strain == (None if strain is None else pytest.approx(strain))


@pytest.mark.parametrize("number", ["15'825,9", "15\u2019825,9", "1.582,9"])
def test_a_decimal_comma_behind_thousands_is_no_separator(number: str, tmp_path: Path) -> None:
    """9 N was read, because a comma also separates the names."""
    path = tmp_path / "load.csv"
    path.write_text(f'% Time "Force, N"\n12:03:44 {number}\n12:03:45 {number}\n', encoding="utf-8")
    with pytest.raises(LinkError, match=r"separated by commas, or .*, separated by blanks"):
        CsvLoadFile(CsvSettings.model_validate({"file": path, "force": {"column": 2}}), HandClock(0))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_other_names_below_are_found_in_the_middle_of_a_long_file(encoding: str, tmp_path: Path) -> None:
    rows = "0,1;134,2;0,5\n" * 6000
    text = f"Time;Force;Ext\n{rows}Time;Ext;Force\n{rows}"
    with pytest.raises(LinkError, match="holds 'Time;Ext;Force' below other names or units"):
        opened(tmp_path / "load.csv", text.encode(encoding))


def test_a_file_without_numbers_is_open_before_a_run(tmp_path: Path) -> None:
    (tmp_path / "load.csv").write_text("Time,Force\n", encoding="utf-8")
    finding = check_load_file(
        "cell", CsvSettings.model_validate({"file": tmp_path / "load.csv", "force": {"column": "Force"}}), HandClock(0)
    )
    assert finding.verdict is Verdict.UNKNOWN
    assert "no line of numbers yet" in finding.observation


@pytest.mark.parametrize("shift", range(4))
def test_a_long_file_with_a_typographic_minus_is_read_at_its_end(tmp_path: Path, shift: int) -> None:
    rows = "−1,5;0,5;−−−−−\n" * 6000
    reading = opened(tmp_path / "load.csv", ("Force;Ext;Note" + "x" * shift + "\n" + rows).encode()).read()
    assert (reading.force_n, reading.extension_mm) == (-1.5, 0.5)


def test_a_remark_is_no_reading(tmp_path: Path) -> None:
    """Blank lines and comments behind the newest line do not make it newer."""
    clock, path = HandClock(), tmp_path / "load.csv"
    path.write_text(f"Time;Force;Ext\n{ROWS}")
    part = CsvLoadFile(CsvSettings.model_validate({"file": path, "force": {"column": "Force"}, "frozen_after_s": 1.0}), clock)
    part.read()
    path.write_text(f"Time;Force;Ext\n{ROWS}# paused\n\n")
    clock.ns += 2 * 10**9
    with pytest.raises(LinkError, match=r"has not grown for 2\.0 s"):
        part.read()
