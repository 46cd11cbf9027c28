"""Names of months in dates, in the languages of computers of microscopes.

The names are those of CLDR, abbreviated and full, without accents, for English, German, French, Spanish, Italian, Polish, Portuguese,
Dutch, Swedish, Danish, Norwegian, Finnish, Czech, Slovak, Hungarian, Romanian, Turkish, Croatian, Slovenian, Russian, Ukrainian and Greek.
``tests/unit/formats/test_dates.py`` compares them with Babel, which has the same data in 10 MB and is not installed with semlive.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator

_NAMES = """
ene enero gen gennaio ian ianuarie jan janeiro janner januar januara januari january janv janvier led leden ledna oca ocak sij
  sijecanj sijecnja sty styczen stycznia tammi tammikuu tammikuuta ιαν ιανουαριοσ ιανουαριου січ січень січня янв январь января
feb febbraio feber febr febrero februar februara februari februarie february fev fevereiro fevr fevrier helmi helmikuu helmikuuta
  lut lutego luty sub subat uno unor unora velj veljaca veljace φεβ φεβρουαριοσ φεβρουαριου лют лютии лютого февр февраль февраля
bre brezen brezna maalis maaliskuu maaliskuuta maart mar marc marca march marcius marco marec mars mart martie marts marz marzec
  marzo mrt mrz ozu ozujak ozujka μαρ μαρτιοσ μαρτιου бер березень березня мар март марта
abr abril apr april aprila aprile aprilie aprilis avr avril dub duben dubna huhti huhtikuu huhtikuuta kwi kwiecien kwietnia nis
  nisan tra travanj travnja απρ απριλιοσ απριλιου апр апрель апреля квіт квітень квітня
kve kveten kvetna mag maggio mai maio maj maja majus may mayis mayo mei svi svibanj svibnja touko toukokuu toukokuuta μαι μαιοσ
  μαιου маи мая трав травень травня
cerven cervna cvn cze czerwca czerwiec giu giugno haz haziran iun iunie juin jun juna june junho juni junij junio junius kesa
  kesakuu kesakuuta lip lipanj lipnja ιουν ιουνιοσ ιουνιου июн июнь июня черв червень червня
cervence cervenec cvc heina heinakuu heinakuuta iul iulie juil juillet jul jula julho juli julij julio julius july lip lipca lipiec
  lug luglio srp srpanj srpnja tem temmuz ιουλ ιουλιοσ ιουλιου июл июль июля лип липень липня
ago agosto agu agustos aout aug august augusta augusti augustus augusztus avg avgust elo elokuu elokuuta kol kolovoz kolovoza sie
  sierpien sierpnia srp srpen srpna αυγ αυγουστοσ αυγουστου авг август августа серп серпень серпня
eyl eylul ruj rujan rujna sep sept september septembra septembre septembrie septiembre set setembro settembre syys syyskuu syyskuuta
  szept szeptember wrz wrzesien wrzesnia zar zari σεπ σεπτεμβριοσ σεπτεμβριου вер вересень вересня сент сентябрь сентября
eki ekim lis listopad listopada loka lokakuu lokakuuta oct october octobre octombrie octubre okt oktober oktobra ott ottobre out
  outubro paz pazdziernik pazdziernika rij rijen rijna οκτ οκτωβριοσ οκτωβριου жовт жовтень жовтня окт октябрь октября
kas kasim lis listopad listopada listopadu marras marraskuu marraskuuta noiembrie nov november novembra novembre novembro noviembre
  stu studeni studenoga νοε νοεμβριοσ νοεμβριου лист листопад листопада нояб ноябрь ноября
ara aralik dec december decembra decembre decembrie des desember dez dezember dezembro dic dicembre diciembre gru grudnia grudzien
  joulu joulukuu joulukuuta pro prosinac prosinca prosince prosinec δεκ δεκεμβριοσ δεκεμβριου груд грудень грудня дек декабрь декабря
"""
MONTH_NAMES: tuple[frozenset[str], ...] = tuple(frozenset(names.split()) for names in re.split(r"\n(?!  )", _NAMES.strip()))
"""Names of each month, from January, as `folded` returns them."""
_LETTERS = str.maketrans({"ß": "ss", "ł": "l", "ı": "i", "đ": "d", "ø": "o"})
_MIN_PREFIX = 3
_CODE_PAGES = ("cp1250", "cp1251", "cp1253", "cp1254", "cp1257")
"""Of central Europe, Cyrillic, Greek, Turkish, Baltic."""
_REPAIRS = (("utf-8", ""), ("cp932", "年午"), ("gb18030", "年午"), ("cp949", "년오"))
"""Code pages, and the letters that show one of them: year, and the first letter of before and after noon."""


def folded(text: str) -> str:
    """Return a text in lower case without accents."""
    decomposed = unicodedata.normalize("NFKD", text.casefold().translate(_LETTERS))
    return "".join(letter for letter in decomposed if not unicodedata.combining(letter)).strip(". ")


def months_named(text: str) -> tuple[int, ...]:
    """Return the months, from 1, that a name may mean: several if languages differ (``lis`` is October or November), none if unknown.

    A name may be shortened to three letters or more. A replacement character matches one letter of an unknown code page.
    """
    name = folded(text)
    spellings = {name, *map(folded, _in_other_code_pages(text))}
    exact = tuple(month for month, names in enumerate(MONTH_NAMES, 1) if names & spellings)
    if exact:
        return exact
    if "?" in name or "\ufffd" in name:
        pattern = re.compile("".join("." if letter in "?\ufffd" else re.escape(letter) for letter in name))
        found = {month for month, names in enumerate(MONTH_NAMES, 1) if any(map(pattern.fullmatch, names))}
    elif len(name) >= _MIN_PREFIX:
        found = {month for month, names in enumerate(MONTH_NAMES, 1) if any(month_name.startswith(name) for month_name in names)}
    else:
        return ()
    return tuple(found) if len(found) == 1 else ()


def _in_other_code_pages(text: str) -> Iterator[str]:
    """Yield a text whose bytes were decoded in the western code page, decoded in other code pages of Windows."""
    for code_page in () if text.isascii() else _CODE_PAGES:
        try:
            yield text.encode("cp1252").decode(code_page)
        except UnicodeError:
            continue


def repaired(text: str) -> str:
    """Return a date or time whose bytes of UTF-8 or an East Asian code page were decoded in the western one, decoded again."""
    for code_page, marks in _REPAIRS:
        try:
            decoded = text.encode("cp1252").decode(code_page)
        except UnicodeError:
            continue
        if not marks or any(mark in decoded for mark in marks):
            return decoded
    return text
