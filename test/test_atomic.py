"""Files and folders that appear whole or not at all."""

import os
from pathlib import Path
import sqlite3
import subprocess
import sys

from flexx2_sim_ros.atomic import named, whole, whole_files, write_text
from flexx2_sim_ros.errors import InputError, MachineError
from programs import started
import pytest


@pytest.mark.parametrize('mask', [0o022, 0o027, 0o077])
def test_written_files_follow_the_umask(tmp_path, mask):
    before = os.umask(mask)
    try:
        write_text(tmp_path / 'a.txt', 'text')
        with whole(tmp_path / 'folder') as part:
            part.mkdir()
    finally:
        os.umask(before)
    assert (tmp_path / 'a.txt').stat().st_mode & 0o777 == 0o666 & ~mask
    assert (tmp_path / 'folder').stat().st_mode & 0o777 == 0o777 & ~mask


def test_a_write_through_a_link_replaces_its_target(tmp_path):
    (tmp_path / 'there').mkdir()
    link = tmp_path / 'link.txt'
    link.symlink_to(tmp_path / 'there' / 'a.txt')
    write_text(link, 'text')
    assert link.is_symlink()
    assert (tmp_path / 'there' / 'a.txt').read_text() == 'text'


def test_files_of_one_write_appear_together(tmp_path):
    with whole_files(tmp_path) as part:
        (part / 'a').write_text('a')
        (part / 'b').write_text('b')
    assert sorted(path.name for path in tmp_path.iterdir()) == ['a', 'b']
    (tmp_path / 'd').mkdir()

    def write():
        with whole_files(tmp_path) as part:
            (part / 'c').write_text('c')
            (part / 'd').write_text('d')

    with pytest.raises(InputError, match='d: cannot be written: must be a file, got a folder'):
        write()
    assert sorted(path.name for path in tmp_path.iterdir()) == ['a', 'b', 'd']


def test_a_full_device_is_named():
    full, of_bag = Path('/dev/full'), Path('a.db3')
    refused = 'no space left on the device$'
    with pytest.raises(MachineError, match=f'^/dev/full: {refused}'), named(full):
        full.write_text('text')
    database = sqlite3.connect(':memory:')
    database.execute('PRAGMA max_page_count = 1')
    with pytest.raises(MachineError, match=f'^a.db3: {refused}'), named(of_bag):
        database.execute('CREATE TABLE topics (name)')
    database.close()


LEAVE = """
import os, sys
from flexx2_sim_ros.atomic import whole
with whole(sys.argv[1]) as part:
    part.write_text('half')
    print(flush=True)
    sys.stdin.readline()
"""


def test_leftovers_of_a_killed_process_are_removed(tmp_path):
    leave = [sys.executable, '-c', LEAVE, tmp_path / 'a']
    with started(leave, stdin=subprocess.PIPE) as process:
        process.stdout.readline()
        write_text(tmp_path / 'b', 'text')
        assert len(list(tmp_path.glob('.flexx2-*'))) == 1
    assert len(list(tmp_path.glob('.flexx2-*'))) == 1
    write_text(tmp_path / 'c', 'text')
    assert sorted(path.name for path in tmp_path.iterdir()) == ['b', 'c']
