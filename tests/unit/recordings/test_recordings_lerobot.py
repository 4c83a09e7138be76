"""Data of LeRobot: each joint is an axis, each episode stands by itself; lists in other Parquet files; pickles."""

import json
import pickle

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.cli import main

pa = pytest.importorskip("pyarrow")
import pyarrow.parquet as parquet  # noqa: E402

FPS, ROWS = 30.0, 120
DEGREE = 180.0 / np.pi


def lists(values, kind="fixed"):
    if kind == "fixed":
        flat = pa.array(np.ascontiguousarray(values, dtype=np.float32).ravel())
        return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    return pa.array(values.tolist(), type=pa.large_list(pa.float64()) if kind == "large" else pa.list_(pa.float64()))


def motion(episode, joint):
    """Position, rad, velocity and torque of a joint with Coulomb friction 0.3 and viscous friction 0.05."""
    time = np.arange(ROWS) / FPS
    phase, sign = 0.7 * episode, 1.0 - 2.0 * joint
    velocity = sign * (np.cos(3.0 * time + phase) + 0.4 * np.cos(7.0 * time + phase))
    position = sign * (np.sin(3.0 * time + phase) / 3.0 + 0.4 / 7.0 * np.sin(7.0 * time + phase))
    return position, velocity, 0.3 * np.sign(velocity) + 0.05 * velocity


def table(episodes, columns):
    time = np.tile(np.arange(ROWS) / FPS, len(episodes)).astype(np.float32)
    return pa.table({"timestamp": time, "episode_index": np.repeat(episodes, ROWS), **columns})


def joined(episodes, joint, place):
    return np.concatenate([motion(episode, joint)[place] for episode in episodes])


def write(root, files, names, **features):
    """A data set: of each file, by its name, the episodes and the columns that ``make`` gives for them."""
    (root / "meta").mkdir(parents=True)
    (root / "data/chunk-000").mkdir(parents=True)
    about = {"observation.state": {"dtype": "float32", "names": names}, **features}
    (root / "meta/info.json").write_text(json.dumps({"codebase_version": "v3.0", "features": about}))
    for name, (episodes, make) in files.items():
        parquet.write_table(table(episodes, make(episodes)), root / "data/chunk-000" / name)
    return root


def interleaved(episodes):
    state = [joined(episodes, joint, place) * (DEGREE if place < 2 else 1.0) for joint in (0, 1) for place in (0, 1, 2)]
    demand = [state[0], state[3]]
    picture = pa.array([{"bytes": b"x", "path": "a"}] * ROWS * len(episodes))
    return {"observation.state": lists(np.stack(state, 1)), "action": lists(np.stack(demand, 1)), "view": picture}


NAMES = [f"{joint}.{kind}" for joint in ("shoulder", "elbow") for kind in ("pos", "vel", "torque")]


@pytest.fixture
def third(tmp_path):
    """Format 3.0: several episodes in a file, names with what they are."""
    action = {"names": {"motors": ["shoulder.pos", "elbow.pos"]}}
    return write(tmp_path / "set", {"file-000.parquet": ([0, 1], interleaved)}, NAMES, action=action)


def test_a_joint_is_an_axis_and_an_episode_a_segment(third):
    found = fh.recordings.read_all(third / "data/chunk-000/file-000.parquet")
    assert list(found) == ["shoulder", "elbow"]
    elbow = found["elbow"]
    for name, place in (("position", 0), ("velocity", 1), ("position_demand", 0)):
        np.testing.assert_allclose(elbow[name], joined([0, 1], 1, place) * DEGREE, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(elbow["torque"], joined([0, 1], 1, 2), rtol=1e-6)
    steps = np.diff(elbow["time_s"])
    assert np.argmax(steps) == ROWS - 1
    assert steps[ROWS - 1] > 10.0 / FPS
    assert np.delete(steps, ROWS - 1) == pytest.approx(1.0 / FPS, abs=1e-5)
    assert elbow.metadata["codebase_version"] == "v3.0"
    told = [problem.split(" ")[0] for problem in elbow.problems]
    assert told == ["position", "velocity", "position_demand"]
    assert all("degrees, percent of the travel or rad" in problem for problem in elbow.problems)


def test_a_data_set_is_identified_joint_by_joint(third, capsys):
    scaled = {name: f"{name}*pi/180" for name in ("position", "velocity", "position_demand")}
    found = fh.identify(third, axis="elbow", column=scaled, models="coulomb")
    assert found.model.friction.parameters["coulomb"] == pytest.approx(0.3, rel=0.02)
    assert not any("percent of the travel" in flag for flag in found.flags)
    assert any("2 parts, each by itself" in flag for flag in found.flags)
    words = [word for name, source in scaled.items() for word in ("--column", f"{name}={source}")]
    main(["identify", str(third), "--axis", "elbow", *words, "--models", "coulomb", "--json"])
    assert json.loads(capsys.readouterr().out) == found.to_dict()
    with pytest.raises(fh.errors.UsageError, match=r"there are: elbow, shoulder"):
        fh.identify(third, models="coulomb")


def test_all_joints_are_identified_at_once(third):
    scaled = {name: f"{name}*pi/180" for name in ("position", "velocity", "position_demand")}
    found = fh.identify_joints(third, joints="shoulder,elbow", column=scaled, models="coulomb")
    levels = {name: each.model.friction.parameters["coulomb"] for name, each in found.joints.items()}
    assert levels == pytest.approx({"shoulder": 0.3, "elbow": 0.3}, rel=0.02)


@pytest.mark.parametrize("kind", ["fixed", "list", "large"])
def test_an_older_data_set_has_a_file_an_episode_and_lists_by_quantity(kind, tmp_path):
    def columns(episodes):
        by_place = [np.stack([joined(episodes, joint, place) for joint in (0, 1)], 1) for place in (0, 1, 2)]
        names = ("observation.state", "observation.velocity", "observation.effort", "observation.current")
        return {name: lists(values, kind) for name, values in zip(names, [*by_place, by_place[2]], strict=True)}

    files = {f"episode_{k:06d}.parquet": ([k], columns) for k in (3, 4)}
    root = write(tmp_path / "set", files, [["main_a", "main_b"]])
    found = fh.recordings.read(root / "data/chunk-000/episode_000004.parquet", "main_b")
    for place, name in enumerate(("position", "velocity", "torque")):
        np.testing.assert_allclose(found[name], joined([4], 1, place), rtol=1e-6, atol=1e-7)
    np.testing.assert_array_equal(found["observation.current"], found["torque"])
    assert found.metadata["episode_index"] == 4
    assert found["time_s"][0] == 0.0
    whole = fh.identify(root, axis="main_a", models="coulomb", scale={"position": 1.0}, group_by="episode_index")
    assert [each["rows"] for each in whole.facts["recordings"]] == [ROWS, ROWS]


@pytest.mark.parametrize(
    "content", [None, "{", "[]", '{"features": 3}', '{"features": {"observation.state": {"names": [1]}}}']
)
def test_without_names_joints_are_numbered(content, tmp_path):
    root = write(tmp_path / "set", {"f.parquet": ([0], interleaved)}, NAMES)
    info = root / "meta/info.json"
    info.unlink() if content is None else info.write_text(content)
    found = fh.recordings.read_all(root / "data/chunk-000/f.parquet")
    assert list(found) == [f"joint_{i}" for i in range(6)]


def test_lists_of_other_files_are_matrices(tmp_path):
    path = tmp_path / "log.parquet"
    values = np.arange(12.0).reshape(4, 3)
    rows = values.tolist()
    missing = [rows[0], None, rows[2], rows[3]]
    columns = {"q": lists(values), "tau": pa.array(missing, type=pa.list_(pa.float64())), "t": np.arange(4.0)}
    columns["odd"] = pa.array([[1.0], [1.0, 2.0], [], [3.0]])
    parquet.write_table(pa.table(columns), path)
    found = fh.recordings.read(path, columns={"time_s": "t", "position": "q[:,1]", "torque": "tau[:,2]*2"})
    assert found["position"].tolist() == [1.0, 4.0, 7.0, 10.0]
    np.testing.assert_array_equal(found["torque"], [4.0, np.nan, 16.0, 22.0])
    assert any(problem.startswith("odd holds lists of different lengths") for problem in found.problems)
    few = fh.recordings.read(path, columns={"time_s": "t", "position": "q[:,1]"}, only=["time_s", "position"])
    assert list(few.columns) == ["time_s", "position"]


LIST = pa.list_(pa.float64())


@pytest.mark.parametrize(
    ("state", "stamps", "text"),
    [
        ([], [], "1 to 256 joints in each row"),
        ([None, None], [0.0, 1.0], "1 to 256 joints in each row"),
        ([[], []], [0.0, 1.0], "1 to 256 joints in each row"),
        ([[1.0], [1.0, 2.0]], [0.0, 1.0], "lists of different lengths"),
        ([[0.0] * 300] * 2, [0.0, 1.0], "more than 256 values"),
        ([[1.0], [2.0], [3.0]], [0.0, float("nan"), 1.0], r"time_s is not finite in 1 of 3 rows"),
        ([[1.0], [2.0]], ["a", "b"], "no column time_s"),
    ],
)
def test_frames_that_make_no_recording_are_refused_by_name(state, stamps, text, tmp_path):
    columns = {"observation.state": pa.array(state, type=LIST), "timestamp": stamps}
    parquet.write_table(pa.table(columns), tmp_path / "f.parquet")
    with pytest.raises(fh.errors.RecordingError, match=text):
        fh.recordings.read_all(tmp_path / "f.parquet")


def test_what_is_missing_in_a_list_is_missing_in_its_joint(tmp_path):
    columns = {"observation.state": pa.array([[1.0, None], [2.0, 3.0]], type=LIST), "timestamp": [0.0, 1.0]}
    parquet.write_table(pa.table(columns), tmp_path / "f.parquet")
    found = fh.recordings.read(tmp_path / "f.parquet", "joint_1")
    np.testing.assert_array_equal(found["position"], [np.nan, 3.0])


class Trap:
    def __reduce__(self):
        return (open, ("trap", "w"))


@pytest.mark.parametrize("suffix", [".pkl", ".pickle"])
def test_a_pickle_is_never_read(suffix, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / f"log{suffix}"
    path.write_bytes(pickle.dumps(Trap()))
    for read in (fh.recordings.read, fh.recordings.read_all, fh.identify):
        with pytest.raises(fh.errors.UsageError, match=r"can run any code.*read_pickle.*log\.parquet"):
            read(path)
    assert not (tmp_path / "trap").exists()
