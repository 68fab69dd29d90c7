"""What is printed while nobody may be listening any more."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from taichi_dem.streams import lasting

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}
TALK = """
import sys
from taichi_dem.streams import lasting
with lasting():
    for k in range(20_000):
        print("a line", k)
        print("another line", k, file=sys.stderr, flush=True)
open(sys.argv[1], "w").write("done")
"""


@pytest.mark.parametrize("closed", ["stdout", "stderr"])
def test_a_program_goes_on_when_its_reader_has_gone(closed, tmp_path):
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, closed: subprocess.PIPE}
    command = [sys.executable, "-c", TALK, tmp_path / "end"]
    program = subprocess.Popen(command, env=ENVIRONMENT, **pipes)
    stream = getattr(program, closed)
    assert b"line 0" in stream.readline()
    stream.close()
    assert program.wait() == 0
    assert (tmp_path / "end").read_text() == "done"


def test_streams_that_were_closed_from_the_start_are_no_hindrance(tmp_path):
    command = f'"{sys.executable}" -c "$1" "$2" >&- 2>&-'
    subprocess.run(["sh", "-c", command, "sh", TALK, tmp_path / "end"], env=ENVIRONMENT, check=True)
    assert (tmp_path / "end").read_text() == "done"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a disk that is full, /dev/full")
def test_a_full_disk_is_no_reader_that_has_gone():
    with open("/dev/full", "w") as full:
        program = subprocess.run([sys.executable, "-c", TALK, "end"], env=ENVIRONMENT, stdout=full)
    assert program.returncode != 0


def test_what_is_printed_arrives(capsys):
    before = sys.stdout
    with lasting():
        print("a line")
        print("a mistake", file=sys.stderr)
    assert capsys.readouterr() == ("a line\n", "a mistake\n")
    assert sys.stdout is before


def test_help_that_nobody_reads_is_done_all_the_same():
    help_of_run = [sys.executable, "-m", "taichi_dem", "run", "--help"]
    program = subprocess.Popen(help_of_run, env=ENVIRONMENT, stdout=subprocess.PIPE)
    program.stdout.close()
    assert program.wait() == 0
