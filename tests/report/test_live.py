"""The served page: on this machine only, judged by keys, and every decision is on the disk."""

import http.client
import importlib.util
import json
import threading
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation.label_review import LabelReview, read_review
from clothtrack.report.document import write_document
from clothtrack.report.live import Decisions, live_page, serve
from clothtrack.report.local_page import Answer, serving
from clothtrack.report.overlay import OverlayConfig
from clothtrack.report.page import ReportConfig, write_report

_spec = importlib.util.spec_from_file_location("chromium", Path(__file__).with_name("chromium.py"))
chromium = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(chromium)

SMALL = ReportConfig(overlay=OverlayConfig(height=120))
READY = "document.body?.dataset.ready === 'yes'"
VERDICTS = "[...document.querySelectorAll('.verdict')].map((one) => one.textContent).join()"
HIGHLIGHTED = "document.querySelector('#review .current .jump').textContent"
SAVED = "document.querySelector('#saved').textContent"


def request(address, method, path, message=None, **headers):
    """Status, headers and content of an answer."""
    url = urlsplit(address)
    connection = http.client.HTTPConnection(url.hostname, url.port, timeout=10)
    try:
        body = None if message is None else json.dumps(message)
        sent = {"Content-Type": "application/json", **headers}
        connection.request(method, path, body, sent)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read().decode()
    finally:
        connection.close()


@pytest.fixture
def decisions(tracked, tmp_path):
    return Decisions(LabelReview.blank(tracked), tmp_path / f"{tracked.name}.review.json")


@pytest.fixture
def address(decisions, tmp_path):
    """A page without a picture, served."""
    addresses = []
    with live_page("fold", decisions=decisions, opened=addresses.append) as page:
        page.show(write_document(tmp_path / "p.html", "fold", "", script=False))
        yield addresses[0]


def test_the_address_is_told_before_the_page_is_written():
    addresses, stop = [], threading.Event()

    def write(path):
        waiting = request(addresses[0], "GET", "/")[2]
        assert "is being written" in waiting
        stop.set()
        return write_document(path, "fold", "", script=False)

    serve("fold", write, opened=addresses.append, stop=stop)
    assert len(addresses) == 1
    with pytest.raises(ConnectionRefusedError):
        request(addresses[0], "GET", "/")


def test_a_port_that_cannot_be_is_refused_before_anything_is_written():
    with pytest.raises(InvalidConfigError, match="port is 99999; choose one"):
        serve("fold", pytest.fail, 99_999)


def test_every_decision_is_on_the_disk_at_once(address, decisions, tracked):
    for action, verdict in ((0, "rejected"), (1, "accepted"), (0, "open")):
        message = {"action": action, "verdict": verdict}
        status, _, body = request(address, "POST", "/review", message)
        written = read_review(decisions.path, tracked)
        assert status == 200
        assert written.labels[action].verdict == verdict
        assert json.loads(body) == written.as_document()
    assert json.loads(request(address, "GET", "/review")[2]) == written.as_document()


def test_a_decision_that_cannot_be_saved_is_not_taken(address, decisions, tmp_path):
    (tmp_path / "file").touch()
    decisions.path = tmp_path / "file" / "fold.review.json"
    message = {"action": 0, "verdict": "rejected"}
    status, _, body = request(address, "POST", "/review", message)
    assert status == 422
    assert "fold.review.json" in json.loads(body)["error"]
    assert decisions.review.rejected == frozenset()


@pytest.mark.parametrize(
    ("action", "verdict", "reason"),
    [(2, "rejected", "actions 0 to 1"), (-1, "open", "actions 0 to 1"), ("0", "open", "actions"),
     (0, "maybe", "accepted, rejected, open"), (0, None, "accepted, rejected, open")],
)  # fmt: skip
def test_what_is_no_decision_is_refused_with_what_can_be_decided(
    address, decisions, action, verdict, reason
):
    message = {"action": action, "verdict": verdict}
    status, _, body = request(address, "POST", "/review", message)
    assert status == 422
    assert reason in json.loads(body)["error"]
    assert not decisions.path.exists()


@pytest.mark.parametrize(
    "foreign",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:{port}"},
        {"Host": "127.0.0.1:1"},
        {"Origin": "http://evil.example"},
        {"Origin": "http://127.0.0.1.evil.example:{port}"},
        {"Origin": "http://localhost:1"},
        {"Origin": "https://localhost:{port}"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_another_web_site_can_neither_read_a_page_nor_decide(address, decisions, foreign):
    port = urlsplit(address).port
    headers = {name: value.format(port=port) for name, value in foreign.items()}
    status, _, body = request(address, "GET", "/", **headers)
    assert status == 403
    assert f"open http://127.0.0.1:{port}/" in body
    message = {"action": 0, "verdict": "rejected"}
    assert request(address, "POST", "/review", message, **headers)[0] == 403
    assert not decisions.path.exists()
    assert request(address, "POST", "/review", message, Origin=address[:-1])[0] == 200


def test_a_link_of_another_web_site_may_be_followed(address):
    followed = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    assert request(address, "GET", "/", **followed)[0] == 200


def test_a_served_page_may_ask_its_server_only_and_lies_in_no_frame(address):
    _, headers, page = request(address, "GET", "/")
    assert "default-src 'none'; " in page
    assert "; connect-src 'self'\">" in page
    assert headers["X-Frame-Options"] == "DENY"


in_browser = pytest.mark.skipif(
    chromium.find_chromium() is None, reason="no Chromium on this machine"
)


@contextmanager
def judged(tracked, recording, decisions, tmp_path, profile="profile"):
    """The report of a trajectory, served and opened in a browser."""
    addresses = []
    with live_page(tracked.name, decisions=decisions, opened=addresses.append) as live:
        live.show(write_report(tracked, recording, tmp_path / "page.html", config=SMALL))
        browser = chromium.find_chromium()
        with chromium.opened(browser, addresses[0], tmp_path / profile) as page:
            page.wait_for(READY)
            yield page
            outside = [url for url in page.requests() if not url.startswith(addresses[0])]
            assert [url for url in outside if not url.startswith(("data:", "blob:"))] == []


def press(page, keys):
    for key in keys:
        page.press(key, key if len(key) > 1 else f"Key{key.upper()}")


@pytest.mark.slow
@in_browser
def test_keys_write_the_review_and_a_page_opened_again_shows_it(
    tracked, two_cameras, decisions, tmp_path
):
    with judged(tracked, two_cameras, decisions, tmp_path) as page:
        assert page.ask(SAVED) == f"Decisions go to {decisions.path.name}"
        assert page.ask("document.querySelector('#save').getClientRects().length") == 0
        for key, verdicts, label in (
            ("a", "accepted,open", 2),
            ("r", "accepted,rejected", 2),
            ("u", "accepted,open", 2),
            ("r", "accepted,rejected", 2),
            ("ArrowUp", "accepted,rejected", 1),
            ("o", "open,rejected", 2),
        ):
            press(page, [key])
            page.wait_for(f"{VERDICTS} === '{verdicts}' && {HIGHLIGHTED} === 'Label {label}'")
            written = read_review(decisions.path, tracked)
            assert ",".join(one.verdict for one in written.labels) == verdicts
        assert page.ask(SAVED) == f"Saved in {decisions.path.name}"
        page.call("Page.reload")
        page.wait_for(f"{READY} && {VERDICTS} === 'open,rejected'")
        assert page.complaints() == []


@pytest.mark.slow
@in_browser
def test_what_is_not_saved_is_not_shown_as_decided(tracked, two_cameras, decisions, tmp_path):
    path = decisions.path
    with judged(tracked, two_cameras, decisions, tmp_path) as page:
        (tmp_path / "file").touch()
        decisions.path = tmp_path / "file" / "fold.review.json"
        press(page, "r")
        page.wait_for(f"{SAVED}.startsWith('Not saved: ') && {SAVED}.includes('fold.review.json')")
        assert page.ask(VERDICTS) == "open,open"
        assert page.ask(HIGHLIGHTED) == "Label 1"
        decisions.path = path
        press(page, "r")
        page.wait_for(f"{VERDICTS} === 'rejected,open' && {SAVED}.startsWith('Saved')")


@pytest.mark.slow
@in_browser
def test_an_open_page_loads_what_is_newer(tmp_path):
    addresses = []
    with live_page("steps", opened=addresses.append) as live:
        browser = chromium.find_chromium()
        with chromium.opened(browser, addresses[0], tmp_path / "profile") as page:
            assert "being written" in page.ask("document.body.innerText")
            for number in (1, 2):
                words = f"<p>step {number}</p>"
                live.show(write_document(tmp_path / "p.html", "steps", words, script=False))
                page.wait_for(f"document.body?.innerText.includes('step {number}')")
            assert page.complaints() == []


ATTACK = """(async () => {
  const body = JSON.stringify({ action: 0, verdict: 'rejected' }), target = '%sreview';
  const headers = { 'Content-Type': 'application/json' };
  const tries = [{ headers }, { mode: 'no-cors' }, { headers, mode: 'no-cors' }];
  const answers = await Promise.all(tries.map((one) =>
    fetch(target, { method: 'POST', body, ...one }).then((answer) => answer.type, () => '')));
  navigator.sendBeacon(target, new Blob([body], { type: 'text/plain' }));
  const form = Object.assign(document.createElement('form'),
    { action: target, method: 'POST', enctype: 'text/plain', target: 'inside' });
  form.append(Object.assign(document.createElement('input'),
    { name: '{"action": 0, "verdict": "rejected", "x": "', value: '"}' }));
  const frame = Object.assign(document.createElement('iframe'), { name: 'inside', src: '%s' });
  document.body.append(form, frame);
  await new Promise((done) => { frame.onload = done; });
  form.submit();
  await new Promise((done) => setTimeout(done, 1000));
  return answers.filter((one) => one === 'basic' || one === 'cors');
})()"""


@pytest.mark.slow
@in_browser
def test_a_page_of_another_origin_cannot_press_reject(decisions, address, tmp_path):
    """In a browser that shows both: the other page fetches, sends a form, and frames ours."""
    other = Answer(b"<!doctype html><body>a foreign page</body>", "text/html")
    browser = chromium.find_chromium()
    with (
        serving(lambda path, query: other, lambda path, message: None) as foreign,
        chromium.opened(browser, foreign, tmp_path / "profile") as page,
    ):
        assert page.ask(ATTACK % (address, address)) == []
        assert any(url.startswith(address) for url in page.requests())
        assert not decisions.path.exists()
        assert decisions.review.rejected == frozenset()
        assert any("X-Frame-Options" in one for one in page.complaints())
        page.call("Page.navigate", url=address)
        page.wait_for("document.querySelector('h1')?.textContent === 'fold'")
        page.ask("""fetch('review', { method: 'POST',
            headers: { 'Content-Type': 'application/json' },
            body: JSON.stringify({ action: 0, verdict: 'rejected' }) }).then(() => true)""")
        assert decisions.review.rejected == {0}
