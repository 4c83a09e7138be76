"""What every format of recordings promises, as tests; a subclass names the format."""

import contextlib
import tracemalloc
import warnings
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import friction_hil as fh
from friction_hil.errors import FrictionHilError, RecordingError, UsageError
from friction_hil.recordings import Recording
from friction_hil.recordings.even import even_grid

ROWS = 40
_names = st.lists(st.from_regex(r"[a-z](_?[a-z0-9]){1,9}", fullmatch=True), min_size=3, max_size=3, unique=True)
_values = arrays(
    np.float64, st.tuples(st.integers(2, 6), st.just(3)), elements=st.floats(allow_infinity=False) | st.just(np.nan)
)
_claims = st.sampled_from(
    [b"\xff" * 4, b"\xff" * 8, b"\x7f" + b"\xff" * 7, bytes(8), b"9" * 9, b"1e308", b"[[[[", b'"']
)
_patches = st.binary(min_size=1, max_size=9) | _claims
_changes = st.lists(st.tuples(st.floats(0.0, 1.0, exclude_max=True), _patches), min_size=1, max_size=4)
_quick = settings(  # one function serves all subclasses, and overwrites the file of its one fixture
    max_examples=25,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.differing_executors],
    deadline=None,
)


def sample(rows: int = ROWS) -> Recording:
    """Known columns, one of them with a gap, and a column that nobody knows."""
    random = np.random.default_rng(1)
    columns = {name: random.normal(size=rows) for name in ("position", "torque", "gear_2")}
    columns["position"][rows // 2] = np.nan
    units = {"torque": "N m", "gear_2": "widget"}
    return Recording("some", "x", {"time_s": np.arange(rows) / 3.0, **columns}, units=units)


def read_or_reason(path: Path) -> Recording | str:
    """Read a file; return the message where it is refused. Warnings and other exceptions are failures."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return fh.recordings.read(path)
        except FrictionHilError as error:
            return str(error)


class RecordingFormatContract:
    """Promises of a format that can be read and written.

    Attributes
    ----------
    suffix : str
        Of its files.
    has_units : bool
        True if it has a place for units.
    holds_infinity : bool
        True if it can hold infinite values.
    is_last_value_doubtful : bool
        True if nothing in the file shows whether its last value is whole.
    """

    suffix: ClassVar[str]
    has_units: ClassVar[bool] = False
    holds_infinity: ClassVar[bool] = True
    is_last_value_doubtful: ClassVar[bool] = False

    @pytest.fixture
    def path(self, tmp_path: Path) -> Path:
        return tmp_path / f"x{self.suffix}"

    # --- round trip

    @_quick
    @given(values=_values, names=_names)
    def test_every_bit_comes_back(self, path: Path, values: np.ndarray, names: list[str]) -> None:
        """Whatever the numbers and the names of unknown columns; NaN stays NaN."""
        time = np.arange(len(values)) * 1e-3
        written = Recording("x", "x", {"time_s": time, **{f"u_{name}": values[:, i] for i, name in enumerate(names)}})
        fh.recordings.write(path, written, overwrite=True)
        read = fh.recordings.read(path)
        assert set(read.columns) == set(written.columns)
        for name, column in written.columns.items():
            known = ~np.isnan(column)
            assert read.columns[name].dtype == np.float64
            np.testing.assert_array_equal(np.isnan(read.columns[name]), ~known)
            assert read.columns[name][known].tobytes() == column[known].tobytes()

    def test_written_again_it_is_the_same(self, path: Path, tmp_path: Path) -> None:
        fh.recordings.write(path, sample())
        second = tmp_path / f"second{self.suffix}"
        fh.recordings.write(second, fh.recordings.read(path))
        first, again = fh.recordings.read(path), fh.recordings.read(second)
        assert list(first.columns) == list(again.columns)
        for name, column in first.columns.items():
            assert column.tobytes() == again.columns[name].tobytes()

    def test_columns_that_nobody_knows_are_carried_along(self, path: Path) -> None:
        fh.recordings.write(path, sample())
        np.testing.assert_array_equal(fh.recordings.read(path).columns["gear_2"], sample().columns["gear_2"])

    def test_only_the_columns_asked_for_are_read(self, path: Path) -> None:
        fh.recordings.write(path, sample())
        read = fh.recordings.read(path, columns={"angle": "position"}, only=["time_s", "angle", "speed"])
        assert set(read.columns) == {"time_s", "angle"}
        assert set(read.others) == {"torque", "gear_2"}
        with pytest.raises(RecordingError, match=r"no column load_torque\. There are: .*gear_2"):
            read.require("load_torque")
        with pytest.raises(UsageError, match="did you mean 'torque'"):
            fh.recordings.read(path, columns={"effort": "torqu"}, only=["time_s"])

    def test_units_are_kept_where_there_is_a_field_for_them(self, path: Path) -> None:
        fh.recordings.write(path, sample())
        units = fh.recordings.read(path).units
        if self.has_units:
            assert {"torque": "N m", "gear_2": "widget"}.items() <= units.items()
            assert fh.recordings.read(path, columns={"load_torque": "torque"}).units["load_torque"] == "N m"
            assert "torque" not in fh.recordings.read(path, scale={"torque": 2.0}).units
        else:
            assert units == {}

    # --- what is no number

    def test_rows_that_are_not_finite_are_reported(self, path: Path) -> None:
        fh.recordings.write(path, sample())
        (problem,) = (each for each in fh.recordings.read(path).problems if each.startswith("position"))
        assert f"not finite in 1 of {ROWS} rows (row {ROWS // 2})" in problem

    def test_infinity_is_kept_and_reported_or_refused(self, path: Path) -> None:
        odd = Recording("", "x", {"time_s": np.arange(3.0), "torque": np.array([0.0, np.inf, -np.inf])})
        if self.holds_infinity:
            fh.recordings.write(path, odd)
            read = fh.recordings.read(path)
            np.testing.assert_array_equal(read["torque"], odd["torque"])
            assert any("torque is not finite in 2 of 3 rows" in problem for problem in read.problems)
        else:
            with pytest.raises(RecordingError, match="torque is infinite in row 1"):
                fh.recordings.write(path, odd)
            assert not path.exists()

    @pytest.mark.parametrize("wrong", [np.nan, np.inf])
    def test_time_that_is_not_finite_is_refused(self, path: Path, wrong: float) -> None:
        time = np.arange(5.0)
        time[2] = wrong
        written = Recording("", "x", {"time_s": time, "torque": np.ones(5)})

        def write_and_read() -> None:
            fh.recordings.write(path, written)
            fh.recordings.read(path)

        with pytest.raises((RecordingError, ValueError), match=r"time_s|NaN"):
            write_and_read()

    # --- damage

    def test_an_empty_file_is_refused(self, path: Path) -> None:
        path.write_bytes(b"")
        with pytest.raises(RecordingError, match="empty") as caught:
            fh.recordings.read(path)
        assert str(path) in str(caught.value)

    def test_a_file_that_is_not_there_is_refused(self, path: Path) -> None:
        with pytest.raises(RecordingError, match="cannot be read: No such file"):
            fh.recordings.read(path)

    def test_a_file_that_is_there_is_not_overwritten(self, path: Path) -> None:
        fh.recordings.write(path, sample())
        before = path.read_bytes()
        with pytest.raises(RecordingError, match="exists already"):
            fh.recordings.write(path, sample(8))
        assert path.read_bytes() == before
        fh.recordings.write(path, sample(8), overwrite=True)
        assert len(fh.recordings.read(path)) == 8

    def test_cut_anywhere_it_is_reported_and_no_row_is_wrong(self, path: Path) -> None:
        whole = sample()
        fh.recordings.write(path, whole)
        data = path.read_bytes()
        for cut in range(0, len(data) - 1, max(1, len(data) // 25)):
            path.write_bytes(data[:cut])
            read = read_or_reason(path)
            if isinstance(read, str):
                assert str(path) in read
                continue
            if self.is_whole(data[:cut]):
                assert read.problems == [] or "not finite" in read.problems[0]
            else:
                assert any("cut off" in problem for problem in read.problems), (cut, read.problems)
            for name, column in read.columns.items():
                rows = len(column)
                if self.is_last_value_doubtful and name == list(whole.columns)[-1] and not self.is_whole(data[:cut]):
                    rows -= 1
                np.testing.assert_array_equal(column[:rows], whole.columns[name][:rows])

    def is_whole(self, data: bytes) -> bool:
        """True if nothing in these bytes shows that more should follow."""
        return False

    @_quick
    @example(noise=b"\x00", keep=72)  # in the header: a column has text, but in no row
    @given(noise=st.binary(max_size=300), keep=st.integers(0, 200))
    def test_other_bytes_end_in_a_message(self, path: Path, noise: bytes, keep: int) -> None:
        fh.recordings.write(path, sample(8), overwrite=True)
        path.write_bytes(path.read_bytes()[:keep] + noise)
        read = read_or_reason(path)
        assert isinstance(read, Recording) or str(path) in read

    @settings(_quick, derandomize=True)  # what a library does with damaged bytes must not decide about other work
    @given(changes=_changes)
    def test_overwritten_bytes_end_in_a_message(self, path: Path, changes: list[tuple[float, bytes]]) -> None:
        """Sizes and shapes are bytes of the file, too: whatever they claim, little is allocated."""
        fh.recordings.write(path, sample(8), overwrite=True)
        data = bytearray(path.read_bytes())
        for position, patch in changes:
            at = int(position * len(data))
            data[at : at + len(patch)] = patch
        path.write_bytes(data)
        read_or_reason(path)  # what it imports for the first time is not counted
        tracemalloc.start()
        read = read_or_reason(path)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 3e7
        if isinstance(read, str):
            assert str(path) in read
        else:
            with warnings.catch_warnings(), contextlib.suppress(RecordingError):
                warnings.simplefilter("error")
                even_grid(read, ["position", "torque"])
