"""`fdcal study`: what is refused says so in one line, before anything that it would need."""

from __future__ import annotations

import sys

import pytest

from fdcal.commands.cli import main


def refusal(capsys, *arguments: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main(["study", *arguments])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


def test_a_report_of_no_folder_is_refused_whether_or_not_dask_is_installed(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    assert "nothing is no folder" in refusal(capsys, "--report", str(tmp_path / "nothing"))


def test_a_file_that_is_no_study_is_named_once(capsys, tmp_path):
    (tmp_path / "bad2.toml").write_text("= 3")
    line = refusal(capsys, str(tmp_path / "bad2.toml"), "--dry-run")
    assert line.count("bad2.toml") == 1 and "is not valid TOML" in line


def test_what_to_install_is_named_for_a_checkout_too(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    line = refusal(capsys, "--report", str(tmp_path))
    assert "pip install -e '.[study]' in a checkout" in line
