"""`flexx2 gap target`: a printable target for ground truth."""

import argparse
from pathlib import Path

from flexx2_sim_ros import atomic
from flexx2_sim_ros.errors import InputError, shown_path

SIZES = 'A4', 'A3', 'A2'
OPTIONS = """
Write a PDF to print at 100 % on a sheet of the given size, and beside it a .yaml that describes it
for flexx2 gap truth --board. Two rulers on the sheet show whether the print is true to scale. See
docs/truth.md.

--out PDF: file to write
--size: size of the sheet (default A3: found up to 2 m; A2 for more)
--force

example: flexx2 gap target --out target.pdf --size A3
"""
VALUES = {
    'out': {'required': True, 'type': Path},
    'size': {'choices': SIZES, 'default': 'A3', 'action': 'store'},
}


def run(arguments: argparse.Namespace) -> int:
    """Write the PDF and its description."""
    from flexx2_sim_ros.truth.target import draw_pdf, target_of

    out = arguments.out
    if out.suffix.lower() != '.pdf':
        raise InputError(f'--out: must end with .pdf, got {shown_path(out)}')
    description = out.with_suffix('.yaml')
    files = [atomic.checked_target(file) for file in (out, description)]
    atomic.check_no_overwrite('--out', files, arguments.force)
    target = target_of(arguments.size)
    with atomic.whole(out) as part:
        part.write_bytes(draw_pdf(target))
    atomic.write_text(description, target.to_yaml())
    print(f'{out}: print at 100 %, then measure its rulers')
    print(f'{description}: describes it for flexx2 gap truth --board')
    return 0
