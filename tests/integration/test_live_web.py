"""Live data over the network: a real daemon, its server, a client of the Foxglove protocol, and a real browser."""

import http.client
import itertools
import json
import math
import os
import signal
import socket
import struct
import subprocess
import threading
from dataclasses import asdict

import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families
from websockets.sync.client import connect

from friction_hil.daemon.control.ask import ask
from friction_hil.daemon.control.names import find
from friction_hil.live import LiveFigures, attach
from friction_hil.recordings import columns, mcap_format
from tests.browser import PROGRAM, browser
from tests.integration.test_runtime_control import answered, children, until
from tests.launcher import start
from tests.servo_drives import axis_dict

pytestmark = pytest.mark.deep

TOKEN = "a-token-of-this-test-0123456789"
NAME = "lathe"


def free_ports(count):
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports


class Client:
    """A client that is no browser."""

    def __init__(self, port):
        self.port = port

    def ask(self, path, *, method="GET", body=None, **headers):
        """Status, headers and body of an answer; None while nobody listens."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        try:
            connection.request(method, path, body, {name.replace("_", "-"): text for name, text in headers.items()})
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read().decode()
        except ConnectionError:
            return None
        finally:
            connection.close()

    def change(self, what, content, **headers):
        given = {"Content-Type": "application/json", "Authorization": f"Bearer {TOKEN}"} | headers
        status, _, text = self.ask(f"/api/{what}", method="POST", body=json.dumps(content), **given)
        return status, json.loads(text)

    def metrics(self):
        answer = self.ask("/metrics")
        if answer is None:
            return {}
        found = {}
        for family in text_string_to_metric_families(answer[2]):
            for sample in family.samples:
                labels = tuple(value for key, value in sorted(sample.labels.items()) if key != "daemon")
                found[sample.name, *labels] = sample.value
        return found

    def is_up(self):
        return self.metrics().get(("friction_hil_up",)) == 1.0


def foxglove(port):
    """Channels that the server offers, and the first messages of each."""
    url = f"ws://127.0.0.1:{port}"
    with connect(url, subprotocols=["foxglove.sdk.v1"], max_size=1 << 24, close_timeout=0.1) as client:
        channels, messages = {}, {"/x": [], "/y": []}
        while len(channels) < 3:
            content = client.recv(30)
            offered = json.loads(content).get("channels", []) if isinstance(content, str) else []
            channels |= {each["topic"]: each for each in offered}
        subscriptions = [{"id": k, "channelId": channels[topic]["id"]} for k, topic in enumerate(messages)]
        client.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
        while min(map(len, messages.values())) < 100:
            content = client.recv(30)
            if isinstance(content, bytes) and content[0] == 1:
                subscription, log_time = struct.unpack_from("<IQ", content, 1)
                messages[list(messages)[subscription]].append((log_time, content[13:]))
        return channels, messages


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """A daemon with two simulated axes that draw a circle, and its server of live data."""
    folder = tmp_path_factory.mktemp("web")
    page, websocket = free_ports(2)
    (folder / "token").write_text(TOKEN)
    (folder / "token").chmod(0o600)
    circle = {"kind": "circle", "radius": 1.0, "frequency": 2.0, "ramp_s": 0.2}
    axes = {
        "x": axis_dict(trajectory=circle, compensation={"fade_s": 0.1, "baseline_s": 1.5}),
        "y": axis_dict(node=2, trajectory={**circle, "phase": -math.pi / 2}),
    }
    (folder / "other.yaml").write_text(yaml.safe_dump(axes["x"]["model"] | {"version": 1}))
    config = folder / f"{NAME}.yaml"
    live = {"dashboard": page, "foxglove": websocket, "token_file": str(folder / "token")}
    values = {"version": 1, "period_s": 5e-3, "bus": {"interface": "socketcan", "channel": "can0"}, "live": live}
    config.write_text(yaml.safe_dump({**values, "realtime": {"priority": 0}, "axes": axes}))
    with start(
        *("run", "--simulate", config, "--pace", "sync", "--wait", "--json"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as daemon:
        daemon.page, daemon.websocket, daemon.folder = Client(page), websocket, folder
        said = []
        reader = threading.Thread(target=lambda: said.append(daemon.stderr.read()))
        reader.start()
        try:
            until(lambda: (answered(NAME, {"do": "status"}) or {}).get("state") == "waiting")
            ask(find(NAME), {"do": "start"})
            until(daemon.page.is_up)
            yield daemon
        finally:
            daemon.send_signal(signal.SIGINT)
            try:
                daemon.stdout.read()
                daemon.wait(60)
            finally:
                daemon.kill()
                reader.join()
    assert TOKEN not in said[0]  # a service's output goes to the journal, which others read
    assert "(its token is in " in said[0]


def test_foxglove_gets_the_rows_as_a_recording_has_them(served):
    channels, messages = foxglove(served.websocket)
    assert sorted(channels) == ["/events", "/x", "/y"]
    assert channels["/events"]["schemaName"] == "foxglove.Log"
    row = channels["/x"]
    assert (row["encoding"], row["schemaEncoding"]) == ("cdr", "ros2msg")
    fields = mcap_format.row_fields(row["schema"])
    assert fields == list(columns.NAMES)
    for received in messages.values():
        rows = [struct.unpack(f"<{len(fields)}d", content[4:]) for _, content in received]
        time_s, cycle = ([each[fields.index(name)] for each in rows] for name in ("time_s", "cycle"))
        assert time_s == pytest.approx([each * 5e-3 for each in cycle])
        assert all(later > earlier for earlier, later in itertools.pairwise(cycle))
        assert [stamp - received[0][0] for stamp, _ in received] == pytest.approx(
            [1e9 * (each - time_s[0]) for each in time_s], abs=2.0
        )


def test_metrics_follow_the_conventions_and_say_what_the_daemon_says(served):
    _, headers, text = served.page.ask("/metrics")
    assert headers["content-type"].startswith("text/plain; version=0.0.4")
    families = {each.name: each for each in text_string_to_metric_families(text)}
    lateness = families["friction_hil_lateness_seconds"]
    assert lateness.type == "histogram"
    counts = [each.value for each in lateness.samples if each.name.endswith("_bucket")]
    total = next(each.value for each in lateness.samples if each.name.endswith("_count"))
    assert counts == sorted(counts)
    assert counts[-1] == total > 0
    for name in ("missed_periods", "rows_lost", "faults"):
        assert families[f"friction_hil_{name}"].type == "counter"
    found = served.page.metrics()
    axis = ask(find(NAME), {"do": "status"})["axes"]["x"]
    assert found["friction_hil_compensation_gain_ratio", "x"] == axis["gain"]
    assert found["friction_hil_drive_powered", "y"] == 1.0
    assert found["friction_hil_state", "running"] == 1.0
    assert abs(found["friction_hil_following_error_radians", "x"]) < 0.5
    parameters = axis_dict()["model"]["friction"]["parameters"]
    assert found["friction_hil_model_parameter", "y", "lugre", "coulomb"] == parameters["coulomb"]


def test_who_attaches_after_the_time_without_compensation_sees_its_error(served):
    """The ring holds 8 s of rows, and later there is none of that time in it."""
    status = until(lambda: (answer := ask(find(NAME), {"do": "status"}))["time_s"] > 12.0 and answer)
    told = status["axes"]["x"]["error_without"]
    assert told["peak"] > told["rms"] > 0.0
    assert told["seconds"] == 0.5  # of 1.5 s, less ramp and settling: one of the periods of the path is whole
    assert status["axes"]["y"]["error_without"] is None  # compensated from the start on
    with attach(NAME) as live:
        figures, reading = LiveFigures(live.facts, live.faults), live.read()
        figures.take(reading)
        assert reading.rows.of("x", "is_enabled").min() == 1.0
        axes = figures.snapshot().axes
    assert asdict(axes["x"].without) == told
    assert axes["y"].without is None
    found = served.page.metrics()
    for part in ("rms", "peak"):
        assert found[f"friction_hil_following_error_{part}_radians", "x", "off"] == told[part]


@pytest.mark.parametrize(
    ("headers", "status", "reason"),
    [
        ({"Authorization": ""}, 401, "this needs the token"),
        ({"Authorization": f"Bearer {TOKEN[:-1]}"}, 401, "the token is wrong"),
        ({"Authorization": f"Bearer {TOKEN[:-1]}\xe9"}, 401, "the token is wrong"),
        ({"Origin": "http://evil.example"}, 403, "a page of http://evil.example"),
        ({"Origin": "null"}, 403, "a page of null"),
        ({"Host": "evil.example"}, 403, "does not answer to the name 'evil.example'"),
        ({"Sec-Fetch-Site": "cross-site"}, 403, "a page of another site"),
        ({"Content-Type": "text/plain"}, 415, "a change is JSON"),
        ({"Content-Length": "65537"}, 413, "at most 65536 bytes"),
    ],
)
def test_no_page_of_another_origin_and_nobody_without_the_token_changes_anything(served, headers, status, reason):
    before = ask(find(NAME), {"do": "status"})["changes"]
    answer, content = served.page.change("set", {"values": {"x.gain": 0.1}}, **headers)
    assert (answer, content["ok"]) == (status, False)
    assert reason in content["problems"][0]
    assert ask(find(NAME), {"do": "status"})["changes"] == before


def test_what_is_refused_is_refused_in_the_words_of_the_control_socket(served):
    for values in ({"x.gain": 9}, {"x.gian": 1}, {"z.gain": 1}, {}, [], {"x.limits": {"torque": 9}}):
        status, content = served.page.change("set", {"values": values})
        direct = answered(NAME, {"do": "set", "values": values})
        assert (status, content["ok"], direct) == (409, False, None)
        with pytest.raises(Exception, match=r".+") as refused:
            ask(find(NAME), {"do": "set", "values": values})
        assert "\n".join(content["problems"]) == str(refused.value)
    status, content = served.page.change("set", {"values": {"x.model": "/etc/passwd"}})
    assert (status, "'/etc/passwd' is no model file beside the configuration" in content["problems"][0]) == (409, True)
    status, content = served.page.change("start", {})  # it runs already
    assert (status, content["ok"]) == (409, False)
    assert served.page.change("start", {}, Authorization="")[0] == 401
    for body, reason in (("[1]", "one JSON object"), ('{"values": {"x.gain": NaN}}', "one JSON object"), ("{", "JSON")):
        status, _, text = served.page.ask("/api/set", method="POST", body=body, **_writing())
        assert (status, reason in text) == (400, True)


def _writing():
    return {"Content-Type": "application/json", "Authorization": f"Bearer {TOKEN}"}


def test_the_page_may_load_nothing_from_elsewhere(served):
    for path in ("/", "/metrics", "/api/nothing", "/../../../etc/passwd"):
        _, headers, _ = served.page.ask(path)
        policy = headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'")
        assert "access-control-allow-origin" not in headers
        assert headers["x-content-type-options"] == "nosniff"
    assert "MIT License" in served.page.ask("/uPlot.LICENSE")[2]


@pytest.mark.skipif(PROGRAM is None and not os.environ.get("CI"), reason="Chromium is not installed")
def test_a_person_at_a_browser_sees_the_daemon_and_changes_it(served, tmp_path):
    with browser(tmp_path) as page:
        page.resize(1280)
        page.open(f"http://127.0.0.1:{served.page.port}/#token={TOKEN}")
        page.until("document.body?.dataset.live === 'yes'")
        assert page.get("location.hash") == ""  # the token does not stay in the address
        assert page.get("[...document.querySelectorAll('h1, .axis h2')].map((each) => each.textContent)") == [
            NAME,
            "Axis x",
            "Axis y",
        ]
        described = (
            "[...document.querySelectorAll('[role=img]')].filter((each) => each.ariaLabel?.includes('%s')).length"
        )
        for words in (
            "Following error, axis y: last 20 s: error",
            "Radius error of the circle",
            "Lateness of the loop:",
        ):
            page.until(described % words)
        page.until("document.querySelector('#circle-text').textContent.includes('magnified')")
        drawn = "[...document.querySelectorAll('.axis canvas')].every((each) => new Set(new Uint32Array(each.getContext"
        page.until(drawn + "('2d').getImageData(0, 0, each.width, each.height).data.buffer)).size > 8)")
        origins = page.get("performance.getEntriesByType('resource').map((each) => new URL(each.name).origin)")
        assert set(origins) == {f"http://127.0.0.1:{served.page.port}"}

        fill = "const gain = document.querySelector('.gain'); gain.value = '%s'; "
        fill += "document.querySelector('.set-gain').click()"
        answer = "document.querySelector('.answer').textContent.includes('%s')"
        page.get(f"{{{fill % 0.7}}}")
        page.until(answer % "changed in cycle")
        assert ask(find(NAME), {"do": "status"})["axes"]["x"]["gain"] == 0.7
        page.get(f"{{{fill % 9}}}")
        page.until(answer % "x.gain: must be")
        page.get("document.querySelector('.set-model').click()")
        page.until(answer % "Choose a model file first")
        labels = "[...document.querySelectorAll('.charts figure')].length"
        assert page.get(f"{labels}") >= 10
        page.get("document.querySelector('#shown-charts input').click()")
        page.until("[...document.querySelectorAll('figure[data-title=Position]')].every((each) => each.hidden)")
        page.get("document.querySelector('#shown-charts input').click()")
        page.get(
            "{const window_s = document.querySelector('#window'); window_s.value = '5';"
            " window_s.dispatchEvent(new Event('change'))}"
        )
        values = "document.querySelectorAll('.axis .u-legend .u-value').length"
        assert (shown := page.get(values)) >= 10  # at the cursor
        choose = "{{const it = document.querySelector('#{}'); {}; it.dispatchEvent(new Event('change'))}}"
        page.get(choose.format("single", "it.checked = true"))
        page.get(choose.format("trigger", "it.value = 'reversal'"))
        page.until("document.querySelector('#scope-text').textContent.startsWith('reversal at ')")
        assert page.get("document.querySelector('#pause').textContent") == "Resume charts"  # one shot
        page.get("document.querySelector('#keep').click()")
        assert page.get(values) == shown + 2 * 7  # a line beside each line of both axes
        page.get("document.querySelector('#pause').click()")
        page.get("document.querySelector('#keep').click()")
        assert page.get(values) == shown
        page.get(choose.format("trigger", "it.value = ''"))
        assert page.get("document.querySelector('#start').hidden")
        page.get("document.querySelector('.enabled').click()")
        page.until("document.querySelector('.enabled').ariaChecked === 'false'")
        assert ask(find(NAME), {"do": "status"})["axes"]["x"]["enabled"] is False

        for is_dark in (False, True):
            page.resize(360, is_dark=is_dark)
            page.until("document.documentElement.scrollWidth === 360", 10.0)  # once charts have taken their new size
        names = "[...document.querySelectorAll('button, input, select')].filter((each) => each.checkVisibility())"
        unnamed = names + ".filter((each) => !each.textContent && !each.labels?.length && !each.ariaLabel).length"
        assert page.get(unnamed) == 0
        assert page.said == [] or all("409" in each for each in page.said)  # what was refused, and nothing else

        [server] = children(served.pid, "friction_hil\0live")
        os.kill(server, signal.SIGSTOP)
        page.until("document.body.dataset.live === 'lost'")
        assert "does not answer" in page.get("document.querySelector('#gone').textContent")
        assert page.get("[...document.querySelectorAll('dd')].every((each) => each.textContent === '–')")
        assert page.get("document.querySelector('#stop').disabled")
        os.kill(server, signal.SIGKILL)
        page.until("document.body.dataset.live === 'yes'")  # another server, with the same token
        page.get("document.querySelector('#stop').click()")
        page.until("document.querySelector('#said').textContent.startsWith('stop: done')")
        assert ask(find(NAME), {"do": "status"})["state"] == "waiting"
        page.until("!document.querySelector('#start').hidden")
        page.get("{window.confirm = () => true; document.querySelector('#start').click()}")
        page.until("document.querySelector('#state').textContent.startsWith('running')")
        assert page.get("document.querySelector('#start').hidden")
        page.get("document.querySelector('#stop').click()")
        page.until("document.querySelector('#said').textContent.startsWith('stop: done')")
        assert answered(NAME, {"do": "status"})["faults"] == []

        served.send_signal(signal.SIGINT)
        page.until("document.body.dataset.live === 'ended'")
        assert f"the daemon '{NAME}' has ended" in page.get("document.querySelector('#gone').textContent")
