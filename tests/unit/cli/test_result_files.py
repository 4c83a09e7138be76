"""Files that a command will write are checked before its work: their folder, name and permission."""

import os

import pytest

from friction_hil.checked_yaml.output import check_writable
from friction_hil.cli import main
from friction_hil.cli.work.result_files import check_result_files
from friction_hil.errors import UsageError

LONG = {
    "train": ["--from-model", "lugre:sigma0=900,coulomb=0.1,stribeck_velocity=0.1"],
    "identify": ["no_such_recording.mcap"],
}


@pytest.mark.parametrize("command", LONG)
@pytest.mark.parametrize(("option", "suffix"), [("--output", ".yaml"), ("--report", ".html")])
def test_a_command_that_works_for_long_refuses_first_what_it_could_not_write(command, option, suffix, tmp_path, capsys):
    target = tmp_path / "gone" / f"result{suffix}"
    assert main([command, *LONG[command], option, str(target)]) == 2
    assert f"{option} {target}: there is no folder {tmp_path / 'gone'}" in capsys.readouterr().err
    folder = tmp_path / f"result{suffix}"
    folder.mkdir()
    assert main([command, *LONG[command], option, str(folder)]) == 2
    assert f"{option} {folder} is a folder; name a file" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["study", "--models", "coulomb"], ["study", "no_such_machine.yaml"]])
def test_a_study_refuses_a_folder_that_it_cannot_make(words, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main([*words, "--output", str(tmp_path / "file" / "study")]) in (1, 2)
    assert "Traceback" not in capsys.readouterr().err


def test_a_file_that_may_not_be_written_is_refused_and_none_is_touched(tmp_path, monkeypatch):
    check_result_files(tmp_path / "net.yaml", None)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # tests may run as root, who may write everywhere
    for path in (tmp_path / "new.yaml", tmp_path):
        with pytest.raises(UsageError, match=r"cannot be written|is a folder"):
            check_writable(path)
