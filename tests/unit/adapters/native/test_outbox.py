"""What waits for a slow client, and what is dropped or ends it."""

from __future__ import annotations

from uwserver_adapters.native.outbox import BATCH_BYTES, BEHIND, QUEUE_BYTES, REPLIES, Outbox

from uwserver.adapter import AdapterStats


class Peer:
    """Takes what the outbox writes; pauses it after a number of writes."""

    def __init__(self, capacity: int = 4, pause_after: int = 10**9) -> None:
        self.stats = AdapterStats()
        self.writes: list[bytes] = []
        self.overflows: list[str] = []
        self.pause_after = pause_after
        self.outbox = Outbox(self._write, self._overflow, capacity, self.stats)

    def _write(self, data: bytes) -> None:
        self.writes.append(data)
        if len(self.writes) >= self.pause_after:
            self.outbox.paused = True

    def _overflow(self, text: str) -> None:
        self.overflows.append(text)
        self.outbox.close()

    @property
    def text(self) -> bytes:
        return b"".join(self.writes)


def test_what_is_gathered_is_written_together_and_replaced_no_more() -> None:
    peer = Peer()
    for tick in range(3):
        peer.outbox.put_sample("p", b"%d " % tick, "latest")
        peer.outbox.gather()
    assert (peer.writes, peer.outbox.is_empty) == ([], False)
    peer.outbox.put_reply(b"reply ")
    peer.outbox.flush()
    assert (peer.writes, peer.outbox.is_empty) == ([b"0 1 2 reply "], True)
    assert (peer.stats.samples_sent, peer.stats.dropped, peer.stats.bytes_sent) == (3, 0, 12)


def test_much_is_written_without_waiting_for_more() -> None:
    peer = Peer(capacity=1000)
    for _ in range(100):
        peer.outbox.put_sample("p", bytes(BATCH_BYTES // 8), "latest")
        peer.outbox.gather()
    assert len(peer.writes) == 12
    peer.outbox.close()
    peer.outbox.flush()
    assert len(peer.writes) == 12
    assert peer.outbox.is_empty


def test_a_transport_that_takes_nothing_gathers_nothing() -> None:
    peer = Peer()
    peer.outbox.put_sample("p", b"0 ", "latest")
    peer.outbox.gather()
    peer.outbox.paused = True
    for tick in (1, 2):
        peer.outbox.put_sample("p", b"%d " % tick, "latest")
        peer.outbox.gather()
        peer.outbox.flush()
    assert (peer.writes, peer.stats.dropped) == ([], 1)
    peer.outbox.resume()
    assert peer.writes == [b"0 2 "]


def test_one_write_a_flush_in_order_of_precedence() -> None:
    peer = Peer()
    peer.outbox.put_sample("p", b"latest ", "latest")
    peer.outbox.put_sample("p", b"ring ", "ring")
    peer.outbox.put_sample("p", b"reliable ", "reliable")
    peer.outbox.put_reply(b"reply ")
    assert not peer.outbox.is_empty
    peer.outbox.flush()
    assert peer.writes == [b"reply reliable ring latest "]
    assert peer.outbox.is_empty
    assert (peer.stats.samples_sent, peer.stats.bytes_sent, peer.stats.dropped) == (3, 27, 0)
    peer.outbox.flush()
    assert len(peer.writes) == 1


def test_ring_drops_the_oldest_and_counts_it() -> None:
    peer = Peer()
    peer.outbox.paused = True
    for number in range(10):
        peer.outbox.put_sample("p", b"%d" % number, "ring")
    assert (peer.outbox.dropped, peer.stats.dropped) == (6, 6)
    peer.outbox.resume()
    assert peer.text == b"6789"


def test_ring_drops_nothing_while_the_peer_takes_bytes() -> None:
    peer = Peer()
    for number in range(10):
        peer.outbox.put_sample("p", b"%d" % number, "ring")
    peer.outbox.flush()
    assert peer.text == b"0123456789"
    assert peer.stats.dropped == 0


def test_latest_keeps_one_a_key() -> None:
    peer = Peer()
    peer.outbox.paused = True
    for number in range(5):
        peer.outbox.put_sample("a", b"a%d" % number, "latest")
        peer.outbox.put_sample("b", b"b%d" % number, "latest")
    peer.outbox.resume()
    assert peer.text == b"a4b4"
    assert peer.stats.dropped == 8


def test_reliable_drops_nothing_and_ends_the_connection() -> None:
    peer = Peer()
    peer.outbox.paused = True
    for number in range(4):
        peer.outbox.put_sample("p", b"%d" % number, "reliable")
    assert not peer.overflows
    peer.outbox.put_sample("p", b"4", "reliable")
    (text,) = peer.overflows
    assert "queue_samples" in text
    assert peer.stats.dropped == 0


def test_reliable_goes_on_while_the_peer_takes_bytes() -> None:
    peer = Peer()
    for number in range(10):
        peer.outbox.put_sample("p", b"%d" % number, "reliable")
    peer.outbox.flush()
    assert peer.text == b"0123456789"
    assert not peer.overflows


def test_replies_are_never_dropped_for_samples() -> None:
    peer = Peer()
    peer.outbox.paused = True
    peer.outbox.put_reply(b"R")
    for _ in range(100):
        peer.outbox.put_sample("p", b"s", "ring")
    peer.outbox.resume()
    assert peer.text == b"Rssss"


def test_too_many_replies_end_the_connection() -> None:
    peer = Peer()
    peer.outbox.paused = True
    for _ in range(REPLIES):
        peer.outbox.put_reply(b"r")
    assert not peer.overflows
    peer.outbox.put_reply(b"r")
    (text,) = peer.overflows
    assert "read the replies" in text
    peer.outbox.put_reply(b"r")
    peer.outbox.put_sample("p", b"s", "ring")
    assert peer.outbox.is_empty
    assert len(peer.overflows) == 1


def test_too_many_bytes_of_replies_end_the_connection() -> None:
    peer = Peer()
    peer.outbox.paused = True
    peer.outbox.put_reply(b"r" * (QUEUE_BYTES + 1))
    assert not peer.overflows, "a single one may be of any length"
    peer.outbox.put_reply(b"r")
    assert peer.overflows


def test_bytes_of_replies_that_left_do_not_count() -> None:
    peer = Peer()
    for _ in range(3):
        peer.outbox.put_reply(b"r" * QUEUE_BYTES)
    for _ in range(3 * REPLIES):
        peer.outbox.put_reply(b"r")
    peer.outbox.flush()
    assert not peer.overflows
    assert len(peer.text) == 3 * QUEUE_BYTES + 3 * REPLIES


def test_what_the_transport_does_not_take_stays_droppable() -> None:
    peer = Peer(capacity=8, pause_after=1)
    peer.outbox.paused = True
    for number in range(8):
        peer.outbox.put_sample("p", b"%d" % number * (BATCH_BYTES // 2), "ring")
    peer.outbox.resume()
    assert len(peer.text) == BATCH_BYTES
    assert peer.outbox.paused
    for number in range(8):
        peer.outbox.put_sample("p", b"%d" % number, "ring")
    assert peer.stats.dropped == 6


def test_closed() -> None:
    peer = Peer()
    for delivery in ("ring", "latest", "reliable"):
        peer.outbox.put_sample("p", b"s", delivery)  # type: ignore[arg-type]
    peer.outbox.put_reply(b"r")
    peer.outbox.close()
    peer.outbox.flush()
    assert peer.writes == []
    assert peer.outbox.is_empty


def test_bytes_are_bounded_as_well_as_numbers() -> None:
    peer = Peer(capacity=100)
    peer.outbox = Outbox(peer._write, peer._overflow, 100, peer.stats, most_bytes=10)
    peer.outbox.paused = True
    for number in range(8):
        peer.outbox.put_sample("p", b"ring%d" % number, "ring")
    assert peer.stats.dropped == 6, "five bytes each"
    peer.outbox.put_sample("q", b"latest", "latest")
    assert peer.stats.dropped == 8
    peer.outbox.put_sample("r", b"a sample of its own size", "ring")
    assert peer.stats.dropped == 9
    peer.outbox.resume()
    assert peer.text == b"a sample of its own size", "a single one may be longer"
    assert not peer.overflows


def test_reliable_makes_what_may_be_lost_go_before_it_gives_up() -> None:
    peer = Peer(capacity=100)
    peer.outbox = Outbox(peer._write, peer._overflow, 100, peer.stats, most_bytes=10)
    peer.outbox.paused = True
    peer.outbox.put_sample("p", b"ring", "ring")
    peer.outbox.put_sample("p", b"reliable", "reliable")
    assert (peer.stats.dropped, peer.overflows) == (1, [])
    peer.outbox.put_sample("p", b"more", "reliable")
    (text,) = peer.overflows
    assert "queue_bytes" in text


def never() -> bool:
    return False


def test_what_comes_behind_a_sample_in_work_keeps_its_order() -> None:
    peer = Peer()
    outbox = peer.outbox
    outbox.put_sample("depth", b"0 ", "latest")
    first = outbox.put_later("eye", "latest", never)
    outbox.put_sample("depth", b"1 ", "latest")
    outbox.gather()
    outbox.put_sample("depth", b"2 ", "latest")
    second = outbox.put_later("eye", "latest", never)
    outbox.gather()
    outbox.put_reply(b"stepped ")
    outbox.flush()
    assert peer.text == b"0 "
    assert not outbox.is_empty
    second(b"B ")
    assert peer.text == b"0 ", "the second waits for the first"
    first(b"A ")
    assert peer.text == b"0 A 1 2 B stepped "
    assert outbox.is_empty
    assert (peer.stats.samples_sent, peer.stats.dropped) == (5, 0)


def test_a_sample_that_could_not_be_made_leaves_the_others() -> None:
    peer = Peer()
    fill = peer.outbox.put_later("eye", "reliable", never)
    peer.outbox.put_reply(b"reply")
    fill(None)
    assert peer.text == b"reply"
    assert peer.stats.samples_sent == 0


def test_who_puts_much_behind_a_sample_in_work_waits_for_it() -> None:
    peer = Peer(capacity=10_000)
    fills = []

    def hurry() -> bool:
        if fills:
            fills.pop()(b"eye ")
            return True
        return False

    fills.append(peer.outbox.put_later("eye", "ring", hurry))
    for _ in range(BEHIND):
        peer.outbox.put_sample("depth", b".", "ring")
    assert peer.text == b""
    peer.outbox.put_sample("depth", b"!", "ring")
    peer.outbox.flush()
    assert peer.text == b"eye " + b"." * BEHIND + b"!"


def test_a_closed_client_gets_no_sample_that_was_in_work() -> None:
    peer = Peer()
    fill = peer.outbox.put_later("eye", "ring", never)
    peer.outbox.put_reply(b"reply")
    peer.outbox.close()
    fill(b"eye")
    assert peer.text == b""
    assert peer.outbox.is_empty
