"""Every format that can be written keeps the contract of recordings."""

import friction_hil as fh
from tests.contract.recording_formats import RecordingFormatContract


class TestMcap(RecordingFormatContract):
    suffix = ".mcap"


class TestCsv(RecordingFormatContract):
    suffix = ".csv"
    is_last_value_doubtful = True

    def is_whole(self, data: bytes) -> bool:
        return data.endswith(b"\n")


class TestParquet(RecordingFormatContract):
    suffix = ".parquet"
    has_units = True


class TestMdf(RecordingFormatContract):
    suffix = ".mf4"
    has_units = True


class TestHdf5(RecordingFormatContract):
    suffix = ".hdf5"
    has_units = True


class TestHdf5UnderItsShortSuffix(TestHdf5):
    suffix = ".h5"


class TestMat(RecordingFormatContract):
    suffix = ".mat"


class TestNpz(RecordingFormatContract):
    suffix = ".npz"


class TestJson(RecordingFormatContract):
    suffix = ".json"
    holds_infinity = False


def test_every_format_has_its_class() -> None:
    suffixes = {each.suffix for each in (*RecordingFormatContract.__subclasses__(), TestHdf5UnderItsShortSuffix)}
    assert suffixes == set(fh.recordings.formats(to_write=True))
