"""A dataset made by a Ray cluster of two nodes is the one that processes of this machine make; actors that die are replaced."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from dataset_fixtures import TINY, contents, put_fields

from gelsim.errors import SceneError
from gelsim.generate.done import Done
from gelsim.generate.run import Extent, Hands, generate
from gelsim.work.workers import work_through

pytestmark = pytest.mark.filterwarnings("ignore")  # Ray's own: sockets, deprecations


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Its address. Two nodes of one core each, which know where the tests' modules are and have one cache."""
    pytest.importorskip("ray")
    import ray
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GELSIM_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
        patch.setenv("RAY_worker_niceness", "0")  # 15 by default: on a busy machine nothing would come of it
        made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        made.add_node(num_cpus=1)
        made.wait_for_nodes()
        yield made.address
        ray.shutdown()
        made.shutdown()


def make_dying(*_: object):
    def work(handful):
        if handful == (3,):
            os._exit(9)
        return Done(handful)

    return work


@pytest.mark.slow
def test_a_cluster_makes_the_same_dataset(cluster: str, tmp_path: Path):
    put_fields(TINY, 3)
    report = generate(TINY, Extent(6), tmp_path / "ray", seed=3, hands=Hands(ray=cluster))
    assert report["workers"] == 2 and report["episodes"] == 6 and report["failed"] == 0
    generate(TINY, Extent(6), tmp_path / "here", seed=3, hands=Hands(workers=1))
    assert contents(tmp_path / "ray") == contents(tmp_path / "here")


@pytest.mark.slow
def test_an_actor_that_dies_is_replaced_and_its_press_listed(cluster: str):
    from gelsim.work.cluster import RayCrew

    def lost(handful: tuple[int, ...], status: str, message: str) -> Done:
        return Done(handful, failures=[{"status": status, "message": message}])

    done = {item.handful: item for item in work_through([(n,) for n in range(6)], RayCrew(cluster), make_dying, (), lost)}
    assert set(done) == {(n,) for n in range(6)}
    assert done[3,].failures[0]["status"] == "DIED"
    assert all(not item.failures for handful, item in done.items() if handful != (3,))


def test_no_cluster_is_told(tmp_path: Path):
    pytest.importorskip("ray")
    with pytest.raises(SceneError, match=r"--ray 127.0.0.1:1: no cluster answers"):
        generate(TINY, Extent(2), tmp_path / "out", hands=Hands(ray="127.0.0.1:1"))
