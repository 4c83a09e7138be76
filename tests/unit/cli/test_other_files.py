"""What somebody else wrote does not choose which other files are read, and nothing of it vanishes without a word."""

import json
import re
import time
import zipfile

import h5py
import numpy as np
import pytest
import yaml

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.config import from_dict, self_contained
from friction_hil.dynamics.xml_input import parse
from friction_hil.errors import ConfigurationError, RecordingError, UsageError
from tests.servo_drives import axis_dict, configuration


def hdf5(kind, folder):
    """A file with columns of its own, and something in a group whose content is in another file."""
    secret, path = folder / "secret", folder / "e.h5"
    secret.write_bytes(np.arange(8.0).tobytes())
    with h5py.File(folder / "other.h5", "w") as other:
        other["secret"] = np.arange(8.0)
    with h5py.File(path, "w", userblock_size=512) as file:
        file["time_s"], file["position"] = np.arange(8.0), np.arange(8.0)
        group = file.create_group("#refs#" if kind.startswith("hidden") else "a").create_group("b")
        if kind.endswith("storage"):
            group.create_dataset("velocity", (8,), "f8", external=[(str(secret), 0, 64)])
        elif kind.endswith("matrix"):
            group.create_dataset("velocity", (2, 2, 2), "f8", external=[(str(secret), 0, 64)])
        elif kind.endswith("link"):
            group["velocity"] = h5py.ExternalLink("other.h5", "/secret")
        elif kind.endswith("dataset"):
            layout = h5py.VirtualLayout((8,), "f8")
            layout[:] = h5py.VirtualSource("other.h5", "secret", (8,))
            group.create_virtual_dataset("velocity", layout)
    with path.open("r+b") as start:
        start.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    return path


@pytest.mark.parametrize("hidden", ["", "hidden "])
@pytest.mark.parametrize("kind", ["external storage", "external matrix", "external link", "virtual dataset"])
@pytest.mark.parametrize("suffix", [".h5", ".mat"])
def test_an_hdf5_file_whose_values_are_in_another_file_is_refused(tmp_path, kind, hidden, suffix):
    path = hdf5(hidden + kind, tmp_path)
    path = path.rename(path.with_suffix(suffix))
    with pytest.raises(RecordingError, match=r"velocity' is in another file, '.*', which is not read"):
        fh.recordings.read(path)
    assert main(["convert", str(path), str(tmp_path / "out.csv")]) == 1
    assert not (tmp_path / "out.csv").exists()


def test_a_virtual_dataset_within_its_file_is_read(tmp_path):
    with h5py.File(tmp_path / "v.h5", "w") as file:
        file["time_s"] = file["position"] = np.arange(8.0)
        layout = h5py.VirtualLayout((8,), "f8")
        layout[:] = h5py.VirtualSource(".", "position", (8,))
        file.create_virtual_dataset("velocity", layout)
    assert fh.recordings.read(tmp_path / "v.h5")["velocity"].tolist() == list(range(8))


def problems_with(folder, *names):
    """What is told of an archive of two arrays, to which these members were added."""
    path = folder / "a.npz"
    np.savez(path, time_s=np.arange(4.0), position=np.arange(4.0))
    with zipfile.ZipFile(path, "a") as file:
        for name in names:
            file.writestr(name, file.read("position.npy"))
    return fh.recordings.read(path).problems


@pytest.mark.parametrize("name", ["velocity.npx", "velocity.np", "velocity", "velocity.npy\n"])
def test_a_member_of_an_archive_that_is_no_array_is_named(tmp_path, name):
    assert problems_with(tmp_path, name) == [f"{name!r} is no array (.npy): left out"]


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_member_that_is_there_twice_is_named_and_of_many_others_the_first(tmp_path):
    problems = problems_with(tmp_path, "position.npy", *(f"{k}.txt" for k in range(1000)))
    assert len(problems) == 22
    assert problems[-2].startswith("980 more")
    assert problems[-1].startswith("'position.npy' is there more than once")


@pytest.mark.parametrize("place", ["model", "shadow", "named shadow"])
def test_a_configuration_inside_a_recording_names_no_file(tmp_path, place):
    path = tmp_path / "model.yaml"
    path.write_text(yaml.safe_dump(self_contained(configuration(x=axis_dict()))["axes"]["x"]["model"]))
    values = self_contained(configuration(x=axis_dict()))
    axis = values["axes"]["x"]
    if place == "model":
        axis["model"] = str(path)
    else:
        axis["shadows"] = [str(path) if place == "shadow" else {"name": "other", "model": str(path)}]
    assert from_dict(values, "machine.yaml").axes["x"].model is not None
    with pytest.raises(ConfigurationError, match=r"must be the model itself: the file '.*model.yaml' is not read"):
        from_dict(values, "run.mcap (configuration inside)", reads_files=False)


@pytest.mark.parametrize("declared", ['<!ENTITY x SYSTEM "file:///etc/passwd">', '<!ENTITY x "y">', ""])
def test_xml_with_entities_is_refused(declared):
    with pytest.raises(UsageError, match="document type declaration"):
        parse(f"<!DOCTYPE robot [{declared}]><robot>&x;</robot>".encode(), "a.urdf", "robot")


@pytest.mark.deep
@pytest.mark.parametrize(("line", "count"), [("k{}: 1", 20_000), ("a: 1", 20_000), ("- 1", 5_000)])
def test_of_very_many_mistakes_the_first_are_printed_and_the_others_counted(tmp_path, capsys, line, count):
    path = tmp_path / "machine.yaml"
    lines = [line.format(k) for k in range(count)]
    path.write_text("version: 1\n" + ("axes:\n" if line.startswith("-") else "") + "\n".join(lines) + "\n")
    began_s = time.process_time()
    assert main(["config", "check", str(path)]) == 2
    assert time.process_time() - began_s < 20.0  # 22 s for 100,000 once, with the output
    told = capsys.readouterr().err.splitlines()
    assert len([each for each in told if "machine.yaml:" in each]) <= 21
    if not line.startswith("-"):
        assert re.search(r"machine.yaml: and [12]\d{4} more mistakes", told[-1])
    assert main(["config", "check", "--json", str(path)]) == 2
    assert json.loads(capsys.readouterr().out)["files"][0]["problems"]
