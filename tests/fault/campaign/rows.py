"""All rows of the campaign."""

from __future__ import annotations

import rows_files
import rows_link
import rows_process

ROWS = (*rows_link.ROWS, *rows_files.ROWS, *rows_process.ROWS)
