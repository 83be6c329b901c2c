"""Who does which piece of work when workers end, stand still or never begin: a made-up crew, and a clock that is turned by hand."""

from __future__ import annotations

import multiprocessing
import random
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import pytest

from gelsim.work import workers
from gelsim.work.workers import Died, Handful, LocalCrew, WorkError, work_through

NEVER = float("inf")
Ends = tuple[str, float]
"""What becomes of something ("done", "died"), and after how many seconds."""


@dataclass
class Made:
    """A worker of the made-up crew: begins, or does a piece, as `Crew.says`."""

    crew: Crew
    number: int
    what: Handful | None = None
    comes: Ends = ("done", 0.0)
    ended: bool = False

    def __post_init__(self) -> None:
        self.give(None)

    def give(self, handful: Handful | None) -> None:
        self.what = handful
        how, seconds = self.crew.says(self, handful)
        self.comes = how, self.crew.now + seconds
        self.crew.given.append((self.number, handful))

    def take(self) -> Handful | None:
        how, when = self.comes
        assert when <= self.crew.now and not self.ended
        self.comes = "done", NEVER
        if how == "died":
            raise Died("made up")
        return self.what

    def end(self) -> None:
        self.ended = True

    def gone(self, until: float) -> None:
        assert self.ended
        if self.crew.lingers is not None and self.crew.lingers(self):
            self.crew.now = max(self.crew.now, until)


@dataclass
class Crew:
    """`says(worker, handful)`: what becomes of it; handful None: of its beginning. Workers are numbered as they are started."""

    count: int
    says: Callable[[Made, Handful | None], Ends]
    now: float = 0.0
    started: list[Made] = field(default_factory=list)
    given: list[tuple[int, Handful | None]] = field(default_factory=list)
    lingers: Callable[[Made], bool] | None = None
    """Whether one that was ended does not let go of what it held."""

    def start(self, *_: object) -> Made:
        self.started.append(Made(self, len(self.started)))
        return self.started[-1]

    def ready(self, some: Sequence[Made], timeout: float) -> list[Made]:
        self.now = min(self.now + timeout, max(self.now, min(worker.comes[1] for worker in some)))
        return [worker for worker in some if worker.comes[1] <= self.now]

    @property
    def at_work(self) -> list[Made]:
        return [worker for worker in self.started if not worker.ended and worker.what is not None and worker.comes[1] > self.now]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[list[int], dict[int, str]]]:
    """Works through so many pieces; those done and those lost, each with why."""

    def go(crew: Crew, pieces: int, still: bool = True, seconds: float = workers.SECONDS) -> tuple[list[int], dict[int, str]]:
        def sleep(seconds: float) -> None:
            crew.now += seconds

        monkeypatch.setattr(workers.time, "monotonic", lambda: crew.now)
        monkeypatch.setattr(workers.time, "sleep", sleep)
        lost: dict[int, str] = {}

        def told(handful: Handful, status: str, _: str) -> None:
            lost[handful[0]] = status

        made = work_through([(number,) for number in range(pieces)], crew, dict, (), told, still, seconds)
        done = [item[0] for item in made if item is not None]
        assert all(worker.ended for worker in crew.started)
        assert sorted([*done, *lost]) == list(range(pieces))  # nothing twice, nothing forgotten
        return done, lost

    return go


def takes(seconds: float, begins: float = 3.0, other: dict[int, Ends] | None = None) -> Callable[[Made, Handful | None], Ends]:
    """Workers that begin, and do each piece, in so many seconds, but for some pieces."""
    return lambda _, handful: ("done", begins) if handful is None else (other or {}).get(handful[0], ("done", seconds))


def test_all_is_done_by_as_many_as_there_are(run: Callable) -> None:
    crew = Crew(4, takes(2.0))
    done, lost = run(crew, 40)
    assert len(done) == 40 and not lost and len(crew.started) == 4 and crew.now == pytest.approx(3.0 + 40 / 4 * 2.0)


def test_a_piece_that_ends_its_worker_is_listed_after_as_many_as_it_has_lives(run: Callable) -> None:
    crew = Crew(3, takes(2.0, other={5: ("died", 1.0)}))
    done, lost = run(crew, 12)
    assert lost == {5: "DIED"} and len(done) == 11
    assert [handful for _, handful in crew.given].count((5,)) == workers.LIVES and len(crew.started) < 3 + workers.LIVES


def test_a_piece_that_ends_everybody_is_alone_at_last(run: Callable) -> None:
    """As under MPS, where an illegal access of one ends all: piece 5 does so, and no other may be lost with it."""

    def says(worker: Made, handful: Handful | None) -> Ends:
        if handful == (5,):
            for other in worker.crew.at_work:
                other.comes = "died", worker.crew.now + 1.0
            return "died", 1.0
        return "done", 3.0

    for count in (1, 2, 8, 32):
        done, lost = run(Crew(count, says), 60)
        assert lost == {5: "DIED"} and len(done) == 59


def test_workers_that_never_begin_end_the_work_and_charge_no_piece(run: Callable) -> None:
    with pytest.raises(WorkError, match="workers ended before they had begun; the last: made up"):
        run(crew := Crew(4, lambda _, handful: ("died", 0.5)), 9)
    assert workers.PATIENCE < crew.now < 2 * workers.PATIENCE and all(worker.ended for worker in crew.started)
    # refused for less than that, it goes on
    crew = Crew(4, lambda worker, handful: ("died", 0.5) if handful is None and worker.crew.now < 20.0 else ("done", 1.0))
    done, lost = run(crew, 9)
    assert len(done) == 9 and not lost and crew.now < 30.0
    assert len(crew.started) < 4 * 20.0 / (0.5 + workers.PAUSE) + 4  # with a pause between


def test_a_place_where_none_begins_does_not_end_the_others_work(run: Callable) -> None:
    """One GPU of several is broken; pieces of the others take longer than PATIENCE."""
    crew = Crew(4, lambda worker, handful: ("died", 0.5) if handful is None and worker.number > 2 else ("done", 100.0))
    done, lost = run(crew, 9)
    assert len(done) == 9 and not lost and crew.now < 420.0
    # nor while the others have not begun yet
    crew = Crew(2, lambda worker, handful: ("died", 0.5) if handful is None and worker.number > 0 else ("done", 100.0))
    assert not run(crew, 3)[1]


def stops(worker: Made, at: float, until: float) -> Ends:
    """All stand still between these times."""
    now = worker.crew.now
    return ("done", NEVER) if at <= now < until else ("done", 8.0)


@pytest.mark.parametrize(("still", "seconds", "gives_up"), [(True, 21.0, False), (False, NEVER, True)])
def test_many_that_stand_still_are_replaced(still: bool, seconds: float, gives_up: bool, run: Callable) -> None:
    """32 workers, pieces of 8 s, all stop between 200 and 208 s: the first is missed at 208 s, and QUIET later all begin anew."""

    def says(worker: Made, handful: Handful | None) -> Ends:
        return ("done", 3.0) if handful is None else stops(worker, 200.0, 208.0)

    crew = Crew(32, says)
    done, lost = run(crew, 2000, still)
    assert set(lost.values()) == ({"TIMEOUT"} if gives_up else set()) and len(lost) == 32 * gives_up
    free = 2000 / 32 * 8.0 + 3.0  # without
    if still:
        assert len(crew.started) == 64 and crew.now < free + 8.0 + seconds + 2 * 3.0 + 8.0


@pytest.mark.parametrize("silent", [0, 20])
def test_a_fault_of_what_they_share_ends_all_before_any_begins_anew(silent: int, run: Callable) -> None:
    """As MPS: after a fault at 200 s each of 32 ends within 15 s, or never, at what it asks of the GPU next, and who begins before the last
    old one is gone waits for ever."""
    seconds = random.Random(1)

    def says(worker: Made, handful: Handful | None) -> Ends:
        now, old = worker.crew.now, worker.number < 32
        if handful is None:
            return "done", 3.0 if old or all(other.ended for other in worker.crew.started[:32]) else NEVER
        if old and now + 8.0 > 200.0:
            return ("died", max(200.0 - now, 0.0) + seconds.uniform(0.0, 15.0)) if worker.number >= silent else ("done", NEVER)
        return "done", 8.0

    crew = Crew(32, says)
    done, lost = run(crew, 2000)
    assert not lost and len(crew.started) <= 32 + 1 + 32  # the first to end is replaced alone
    assert crew.now < 2000 / 32 * 8.0 + 3.0 + 8.0 + 15.0 + 3.0 + 8.0


def test_two_that_end_without_sharing_anything_end_nobody_else(run: Callable) -> None:
    crew = Crew(8, takes(2.0, other={20: ("died", 1.0), 21: ("died", 1.5)}))
    done, lost = run(crew, 100, still=False)
    assert lost == {20: "DIED", 21: "DIED"} and len(crew.started) <= 8 + 2 * workers.LIVES


@pytest.mark.parametrize("count", [4, 8, 32])
def test_pieces_that_end_their_workers_take_no_other_along(count: int, run: Callable) -> None:
    """They come back next to each other, alone at last, and are no fault of what workers share."""
    bad = {5: ("died", 1.0), 6: ("died", 1.0)} | {n: ("died", 0.5) for n in range(40, 300, 30)}
    done, lost = run(Crew(count, takes(3.0, other=bad)), 300)
    assert set(lost) == set(bad)


def test_who_never_lets_go_holds_nobody_up(run: Callable) -> None:
    """As above, and nine of the old ones stay where they are; of those that share with them none is waited for while another is at work."""

    def says(worker: Made, handful: Handful | None) -> Ends:
        return ("done", 3.0) if handful is None else stops(worker, 200.0, 208.0)

    def lingers(worker: Made) -> bool:
        assert not [other for other in crew.started[:32] if not other.ended]
        return worker.number < 9 and worker.crew.now < 300.0

    crew = Crew(32, says, lingers=lingers)
    done, lost = run(crew, 2000)
    assert not lost and len(crew.started) == 64 and crew.now < 2000 / 32 * 8.0 + 3.0 + 8.0 + 21.0 + 2 * 3.0 + 8.0 + 2 * workers.GONE


def test_a_process_that_does_not_end_is_not_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is held in the kernel on its way out; planted: killing does nothing."""
    process = LocalCrew(1).start(0, _sleeper, ())
    monkeypatch.setattr(process.process, "kill", lambda: None)
    assert process.take() is None  # it has begun
    begun = time.monotonic()
    process.end()
    process.gone(begun + 0.2)
    assert time.monotonic() - begun < 5.0 and process.process.is_alive()
    assert process.process not in multiprocessing.active_children(), "at its end Python waits for those"
    process.process.terminate()
    process.process.join()


def _sleeper() -> Callable[[Handful], None]:
    threading.Timer(60.0, lambda: None).start()  # keeps it, whose pipe is closed
    return lambda _: None


def test_a_standstill_at_the_end_replaces_who_has_nothing_to_do_too(run: Callable) -> None:
    """49 pieces for 32: 17 stand still in the second round, and the others hold what they share."""
    crew = Crew(32, lambda worker, handful: ("done", 3.0) if handful is None else stops(worker, 10.0, 15.0))
    done, lost = run(crew, 49)
    assert not lost and len(crew.started) == 64


@pytest.mark.parametrize(("still", "lost"), [(True, {}), (False, {399: "TIMEOUT"})])
def test_the_last_that_stands_still_is_not_waited_for_half_an_hour(still: bool, lost: dict[int, str], run: Callable) -> None:
    """Pieces of a few seconds that may take 150: the last one's worker stands still, a fresh one does it."""

    def says(worker: Made, handful: Handful | None) -> Ends:
        return "done", NEVER if handful == (399,) and worker.number < 16 else 4.0

    crew = Crew(16, says)
    found, gone = run(crew, 400, still, seconds=150.0)
    assert gone == lost and len(found) == 400 - len(lost)
    # Beginning and 25 rounds of 4 s, the 150 s; then a pause of 1 s, a beginning, the piece; each noticed within 1 s.
    assert crew.now < 26 * 4.0 + 150.0 + (1.0 + 2 * 4.0) + 4 * 1.0


def test_all_that_stand_still_before_the_first_answer_are_waited_for_longer(run: Callable) -> None:
    """Kernels are compiled then: 100 s are no standstill, 200 s are."""
    for seconds, begun in ((100.0, 32), (200.0, 64)):

        def says(worker: Made, handful: Handful | None, seconds: float = seconds) -> Ends:
            return ("done", 3.0) if handful is None else ("done", seconds if worker.number < 32 and worker.crew.now < 50.0 else 8.0)

        crew = Crew(32, says)
        done, lost = run(crew, 200)
        assert not lost and len(crew.started) == begun


@pytest.mark.parametrize("count", [1, 2, 4, 8, 32])
def test_slow_pieces_are_no_standstill(count: int, run: Callable) -> None:
    """Seconds as of a dataset's presses: most 3, one in 200 up to 823; none may be lost or done anew for them."""
    seconds = random.Random(count)
    known = {n: (seconds.uniform(120.0, 823.0) if seconds.random() < 0.005 else seconds.lognormvariate(1.1, 0.7)) for n in range(3000)}
    crew = Crew(count, lambda _, handful: ("done", 3.0 if handful is None else known[handful[0]]))
    done, lost = run(crew, 3000)
    assert not lost and len(crew.started) == count


def test_pieces_that_become_slower_are_taken_for_a_standstill_once(run: Callable) -> None:
    crew = Crew(32, takes(6.0, other={n: ("done", 50.0 + n % 20) for n in range(2000, 2300)}))
    done, lost = run(crew, 2300)
    assert not lost and len(crew.started) == 64


def test_a_crew_that_ended_may_take_long_to_begin_again(run: Callable) -> None:
    """A beginning of 150 s is no standstill either."""

    def says(worker: Made, handful: Handful | None) -> Ends:
        fresh, late = worker.number >= 32, worker.crew.now >= 100.0
        if handful is None:
            return "done", 150.0 if fresh else 3.0
        return ("done", 8.0) if fresh or not late else ("died", 1.0)

    crew = Crew(32, says)
    done, lost = run(crew, 1000)
    assert not lost and len(crew.started) == 64


def test_a_second_standstill_waits_for_kernels_too(run: Callable) -> None:
    """After the first one the new crew's first pieces take 150 s."""

    def says(worker: Made, handful: Handful | None) -> Ends:
        if handful is None:
            return "done", 3.0
        return stops(worker, 200.0, 208.0) if worker.number < 32 else ("done", 150.0 if worker.crew.now < 300.0 else 8.0)

    crew = Crew(32, says)
    done, lost = run(crew, 2000)
    assert not lost and len(crew.started) == 64


def test_a_piece_may_take_so_long_and_no_longer(run: Callable) -> None:
    crew = Crew(3, takes(2.0, other={1: ("done", NEVER), 2: ("done", workers.SECONDS - 1.0)}))
    done, lost = run(crew, 6, still=False)
    assert lost == {1: "TIMEOUT"} and len(done) == 5 and [handful for _, handful in crew.given].count((1,)) == 1


def test_whatever_happens_nothing_is_lost_or_done_twice(run: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers that end by lot; `run` counts."""
    monkeypatch.setattr(workers, "PATIENCE", 1e4)  # one worker alone may well not begin three times
    for seed in range(40):
        lot = random.Random(seed)

        def says(_: Made, handful: Handful | None, lot: random.Random = lot) -> Ends:
            return ("died" if lot.random() < 0.15 else "done"), lot.uniform(0.1, 30.0)

        run(Crew(lot.randint(1, 8), says), lot.randint(1, 60), still=bool(seed % 2))


def test_who_stops_reading_ends_all(monkeypatch: pytest.MonkeyPatch) -> None:
    crew = Crew(3, takes(2.0))
    monkeypatch.setattr(workers.time, "monotonic", lambda: crew.now)
    made = work_through([(n,) for n in range(9)], crew, dict, (), lambda *_: None)
    next(made)
    made.close()
    assert len(crew.started) == 3 and all(worker.ended for worker in crew.started)


def test_a_start_that_fails_ends_those_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    crew = Crew(3, takes(2.0))
    monkeypatch.setattr(workers.time, "monotonic", lambda: crew.now)
    start = crew.start
    monkeypatch.setattr(crew, "start", lambda *_: start() if len(crew.started) < 2 else 1 / 0)
    with pytest.raises(ZeroDivisionError):
        list(work_through([(n,) for n in range(9)], crew, dict, (), lambda *_: None))
    assert len(crew.started) == 2 and all(worker.ended for worker in crew.started)
