"""The drivers' page names each variant."""

from __future__ import annotations

import re
from pathlib import Path

from drivers.simulation.variants import VARIANTS

PAGE = Path(__file__).parents[3] / "drivers" / "README.md"


def test_the_table_has_each_variant_once():
    table = PAGE.read_text().partition("| variant |")[2].partition("\n\n")[0]
    rows = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    assert sorted(name for row in rows for name in re.findall("`(.*?)`", row)) == sorted(VARIANTS)
