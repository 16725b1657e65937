"""Completion scripts of the shells, run by the shells."""

import shutil
import subprocess

import pytest

from loewner.cli import main
from loewner.cli.completion import SHELLS

pytestmark = pytest.mark.light

CASES = {
    "loewner cle": ["clearance"],
    "loewner robot ": ["check", "info"],
    "loewner robot check --mod": ["--model"],
    "loewner robot check --model ": ["auto", "hull", "pieces", "surface"],
    "loewner report robot arm.urdf --model h": ["hull"],
    "loewner --print-completion ": sorted(SHELLS),
    "loewner plan --proo": ["--proof"],
    "loewner plan --base ": ["car", "differential"],
}

# What bash does at a tab; a word after the last blank is empty.
DRIVER = """
compopt() { :; }
while IFS= read -r line; do
  read -ra COMP_WORDS <<<"$line"
  [[ $line == *" " ]] && COMP_WORDS+=("")
  COMP_CWORD=$((${#COMP_WORDS[@]} - 1)) COMPREPLY=()
  _shtab_loewner
  echo "${COMPREPLY[*]}"
done
"""


def script(shell, capsys):
    """The output of the command, which then ends."""
    with pytest.raises(SystemExit) as end:
        main(["--print-completion", shell])
    assert end.value.code == 0
    return capsys.readouterr().out


def ran(*command, text="", **options):
    return subprocess.run(command, input=text, capture_output=True, text=True, check=True, **options).stdout


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_bash_completes(capsys, tmp_path):
    """Commands, options and choices are offered where they fit, and files elsewhere."""
    (tmp_path / "complete").write_text(script("bash", capsys) + DRIVER)
    for name in ("arm.urdf", "box.npz"):
        (tmp_path / name).touch()
    arm = ["arm.urdf"]
    files = {"loewner plan arm": arm, "loewner check box.npz bo": ["box.npz"], "loewner plan --srdf a": arm}
    lines = "\n".join([*CASES, *files]) + "\n"
    offers = ran("bash", "--norc", "complete", text=lines, cwd=tmp_path).splitlines()
    assert [sorted(line.split()) for line in offers] == [*CASES.values(), *files.values()]


@pytest.mark.skipif(shutil.which("fish") is None, reason="no fish here")
@pytest.mark.parametrize("line", CASES)
def test_fish_completes(line, capsys, tmp_path):
    """The same offers, each with its help."""
    (tmp_path / "complete").write_text(script("fish", capsys))
    out = ran("fish", "--no-config", "-c", f"source {tmp_path / 'complete'}; complete -C '{line}'")
    assert sorted(row.split("\t")[0] for row in out.splitlines()) == CASES[line]


def test_zsh_offers_files_for_every_argument(capsys):
    """The pattern of arguments of any number is one that zsh repeats."""
    text = script("zsh", capsys)
    assert '"*:saved bodies (.npz) or meshes:_files"' in text
    assert '"(*)' not in text


@pytest.mark.parametrize("shell", SHELLS)
def test_scripts_are_valid(shell, capsys, tmp_path):
    """The shells read the scripts without a fault, and no help has a placeholder left."""
    text = script(shell, capsys)
    assert "%(" not in text
    (tmp_path / "complete").write_text(text)
    if shutil.which(shell) and shell != "powershell":
        ran(shell, "-n", str(tmp_path / "complete"))


def test_other_shells_are_refused(capsys):
    """The message lists the shells."""
    with pytest.raises(SystemExit) as end:
        main(["--print-completion", "ksh"])
    assert end.value.code == 2
    assert ", ".join(SHELLS) in capsys.readouterr().err.replace("'", "")
