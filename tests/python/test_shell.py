"""Completion and manual page, tested with bash, zsh and man."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from conftest import malus as run_malus

pytest.importorskip("shtab")


def completed(script: Path, words: str, cwd: Path) -> set[str]:
    """The completions that bash offers after these words."""
    program = f"""source {script}
COMP_WORDS=({words} ''); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))
$(complete -p malus | sed 's/.*-F \\([^ ]*\\) .*/\\1/') malus '' ''
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    done = subprocess.run(["bash", "-c", program], cwd=cwd, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


def test_bash_completes_commands_and_values(tmp_path: Path) -> None:
    told = run_malus("completion", "bash")
    assert told.code == 0, told.err
    script = tmp_path / "malus.bash"
    script.write_text(told.out)
    assert {"run", "export", "compare", "check"} <= completed(script, "malus", tmp_path)
    assert {"glb", "iiif", "archive"} <= completed(script, "malus export --format", tmp_path)


def test_zsh_accepts_its_script(tmp_path: Path) -> None:
    told = run_malus("completion", "zsh")
    assert told.code == 0 and told.out.startswith("#compdef malus")
    if shutil.which("zsh"):
        (tmp_path / "_malus").write_text(told.out)
        subprocess.run(["zsh", "-n", tmp_path / "_malus"], check=True, timeout=60)


def test_manual_page_has_every_command() -> None:
    told = run_malus("manual")
    assert told.code == 0, told.err
    assert told.out.startswith(".TH MALUS")
    if shutil.which("man") is None:
        pytest.skip("man is not installed")
    page = subprocess.run(
        ["man", "-l", "-"],
        input=told.out,
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "LC_ALL": "C"},
    )
    assert page.returncode == 0
    for words in ("malus compare", "malus export", "--albedo", "--same-frame"):
        assert words in page.stdout
