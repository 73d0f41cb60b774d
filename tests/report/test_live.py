import gc
import http.client
import logging
import re
import threading
import time

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.report.live import view_live


def _address(caplog):
    for _ in range(200):
        found = re.search(r"http://(127\.0\.0\.1):(\d+)", caplog.text)
        if found:
            return found.group(1), int(found.group(2))
        time.sleep(0.05)
    raise AssertionError("the address was not logged")


# The server's event loop may end before it has seen its client go; what it then leaves is found
# here, and not in whatever test comes next.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_page_is_served_until_it_is_stopped(tracked, clouds_only, caplog):
    stop = threading.Event()
    caplog.set_level(logging.INFO, logger="clothtrack")
    thread = threading.Thread(target=view_live, args=(tracked, clouds_only), kwargs={"stop": stop})
    thread.start()
    try:
        connection = http.client.HTTPConnection(*_address(caplog), timeout=10)
        connection.request("GET", "/")
        assert connection.getresponse().status == 200
        connection.close()
    finally:
        stop.set()
        thread.join(timeout=20)
    assert not thread.is_alive()
    gc.collect()


def test_a_port_that_cannot_be_is_refused_and_not_waited_for(tracked, clouds_only):
    with pytest.raises(InvalidConfigError, match="port is 99999; choose one"):
        view_live(tracked, clouds_only, 99_999)
