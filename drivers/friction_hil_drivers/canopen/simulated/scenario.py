"""Events in the life of a simulated drive: what goes wrong, and when."""

from collections.abc import Iterator, Sequence
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

_NS = 1_000_000_000

# Fields that an action takes beside at_s and for_s: those that it needs, and those that it may have
_FIELDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "pre_operational": ((), ()),
    "stopped": ((), ()),
    "operational": ((), ()),
    "reboot": ((), ()),
    "mute": ((), ()),
    "deaf": ((), ()),
    "unplug": ((), ()),
    "disable": ((), ()),
    "emergency": (("code",), ()),
    "fault": (("code",), ()),
    "statusword": ((), ("set", "clear")),
    "write": (("index", "value"), ("subindex",)),
    "freeze_encoder": ((), ()),
    "jump_encoder": (("counts",), ()),
    "stop_tpdo": ((), ("tpdo",)),
    "lose_tpdo": (("share",), ("tpdo",)),
    "late_tpdo": (("by_s",), ("tpdo",)),
    "cut_tpdo": (("length",), ("tpdo",)),
    "babble": (("can_id",), ("data", "per_ms")),
}
_FINAL = ("pre_operational", "stopped", "operational", "disable", "fault", "write")  # for_s means nothing to them

Seconds = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Unsigned16 = Annotated[int, Field(ge=0, le=0xFFFF)]


class Event(BaseModel):
    """Something that the drive does, or that happens to it.

    ========================================  =====================================================================
    do                                        effect
    ========================================  =====================================================================
    pre_operational, stopped, operational     enters this NMT state by itself
    reboot                                    loses its supply for ``for_s`` (or an instant), then boots
    mute                                      sends nothing
    deaf                                      hears nothing
    unplug                                    both
    disable                                   loses its power stage: Switch on Disabled (STO)
    emergency                                 reports ``code``, and takes it back after ``for_s``
    fault                                     enters Fault with ``code``
    statusword                                shows the bits ``set`` and ``clear`` in 6041h, whatever its state
    write                                     changes the object ``index``, ``subindex`` to ``value`` by itself
    freeze_encoder                            6064h stays; loops and 606Ch go on
    jump_encoder                              6064h is off by ``counts``
    stop_tpdo                                 does not send ``tpdo`` (all when not given)
    lose_tpdo                                 does not send the ``share`` of them, at random but reproducibly
    late_tpdo                                 sends them ``by_s`` later; with --pace sync at the first SYNC after that
    cut_tpdo                                  sends only their first ``length`` bytes
    babble                                    sends ``per_ms`` frames ``can_id`` with ``data`` (hexadecimal)
    ========================================  =====================================================================
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    at_s: Seconds = Field(description="time from the first SYNC in Operational, s")
    do: Literal[
        "pre_operational",
        "stopped",
        "operational",
        "reboot",
        "mute",
        "deaf",
        "unplug",
        "disable",
        "emergency",
        "fault",
        "statusword",
        "write",
        "freeze_encoder",
        "jump_encoder",
        "stop_tpdo",
        "lose_tpdo",
        "late_tpdo",
        "cut_tpdo",
        "babble",
    ]
    for_s: Seconds | None = Field(None, description="time after which it ends, s; never when not given")
    code: Unsigned16 | None = Field(None, description="error code, e.g. 0x2310")
    set: Unsigned16 | None = Field(None, description="bits of 6041h that are shown as 1")
    clear: Unsigned16 | None = Field(None, description="bits of 6041h that are shown as 0")
    index: Unsigned16 | None = Field(None, description="object")
    subindex: int | None = Field(None, ge=0, le=255, description="0 when not given")
    value: int | None = Field(None, description="new value of the object")
    counts: int | None = Field(None, description="counts added to 6064h")
    tpdo: int | None = Field(None, ge=1, le=512, description="number of the TPDO; all when not given")
    share: float | None = Field(None, ge=0.0, le=1.0, description="share of the frames that is lost")
    by_s: Seconds | None = Field(None, description="lateness, s")
    length: int | None = Field(None, ge=0, le=7, description="bytes that are left of a TPDO")
    can_id: int | None = Field(None, ge=0, le=0x7FF, description="identifier")
    data: str | None = Field(
        None, pattern="^([0-9a-fA-F]{2}){0,8}$", description="data in hexadecimal; none if not given"
    )
    per_ms: int | None = Field(None, ge=1, le=100, description="frames per millisecond; 1 when not given")

    @model_validator(mode="after")
    def _check_fields(self) -> Self:
        needed, optional = _FIELDS[self.do]
        own = {"at_s", "do", "for_s"}
        given = {name for name in type(self).model_fields if name not in own and getattr(self, name) is not None}
        if missing := [name for name in needed if name not in given]:
            raise ValueError(f"{self.do} needs {', '.join(missing)}")
        if extra := sorted(given - {*needed, *optional}):
            takes = ", ".join((*needed, *optional)) or "no other fields"
            raise ValueError(f"{self.do} has no {', '.join(extra)}; it takes {takes}")
        if self.for_s is not None and self.do in _FINAL:
            raise ValueError(f"{self.do} has no for_s: it happens once")
        return self


class Timeline:
    """Order of events, which are given in any order: each begins, and most end."""

    def __init__(self, events: Sequence[Event]) -> None:
        self._marks = [(round(event.at_s * _NS), True, event) for event in events]
        self._marks += [
            (round((event.at_s + event.for_s) * _NS), False, event) for event in events if event.for_s is not None
        ]
        self._marks.sort(key=lambda mark: mark[0])  # stable: of an event without duration the beginning comes first
        self._start_ns: int | None = None

    def start(self, now_ns: int) -> None:
        """Begin to count, unless it does already."""
        if self._start_ns is None:
            self._start_ns = now_ns

    def take(self, now_ns: int) -> Iterator[tuple[Event, bool]]:
        """Yield the events that begin (True) or end (False) by ``now_ns``, each once."""
        while self._start_ns is not None and self._marks and now_ns - self._start_ns >= self._marks[0][0]:
            _, begins, event = self._marks.pop(0)
            yield event, begins
