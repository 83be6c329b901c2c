"""The matrix's layout against SciPy's assembly, and the two direct solvers against each other."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
import warp as wp
from fem_fixtures import MM, Array, ball_scene, box_mesh, flat_gel, problem_of, rigid_body, solids_of, tangent_of

from gelsim.fem import linear
from gelsim.fem.assembly import Solids
from gelsim.fem.batch import run_batch
from gelsim.fem.linear import PardisoSolver, Product, SuperLUSolver, SymmetricSystem, find_mkl, float64_factors, gmres, make_solver
from gelsim.fem.pattern import build_pattern, element_pairs, pair_keys
from gelsim.fem.quasistatic import run_press
from gelsim.fem.reference import element_tangent
from gelsim.scene.materials import ElasticMaterial
from gelsim.work.workers import settings

EPS = np.finfo(float).eps
needs_mkl = pytest.mark.skipif(find_mkl() is None, reason="no MKL here")


def small_solids(nu: float = 0.4999, cells: int = 2) -> Solids:
    """A block on three sliding planes, strained and with a pressure field."""
    line = np.linspace(0, 1, cells + 1) * MM
    mesh = box_mesh(line, line, line, ("bottom", "top", "side"), shake=0.2)
    solids = solids_of(mesh, ElasticMaterial.from_modulus(50e3, nu), np.abs(mesh.rest_positions) < 1e-12)
    rng = np.random.default_rng(2)
    free = solids.free
    u = np.where(free[:, :3], 0.02 * rng.uniform(-1, 1, solids.rest.shape) / cells, 0.0)
    solids.set_state((u, np.where(free[:, 3], rng.uniform(-5, 5, len(u)), 0.0)))
    return solids


def test_assembly_equals_scipys() -> None:
    solids = small_solids()
    u, p = solids.state()
    _, _, _, gradients, weights, shape, law, kappa = (array.numpy() for array in solids._inputs)
    rows, columns, values = [], [], []
    for t, tet in enumerate(solids.tets):
        place = np.concatenate([(4 * tet[:, None] + np.arange(3)).ravel(), 4 * tet[:4] + 3])
        unknowns = np.concatenate([u[tet].ravel(), p[tet[:4]]])
        block = element_tangent(unknowns, gradients[t], weights[t], shape, law[t], float(kappa[t]))
        rows.append(np.repeat(place, 34))
        columns.append(np.tile(place, 34))
        values.append(block.ravel())
    count = 4 * len(u)
    whole = sp.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(count, count))
    kept = np.flatnonzero(solids.free.ravel())
    wanted = whole[kept][:, kept].toarray()
    assert (solids.free[:, :3].any(axis=1) & ~solids.free[:, :3].all(axis=1)).any(), "partly fixed nodes are the hard case"
    # 30 ulps of the largest entry, as in tests/gradient/test_fem_twin.py, times up to 24 tets at a node: root of it
    assert np.abs(tangent_of(solids).toarray() - wanted).max() <= 150 * EPS * np.abs(wanted).max()


def test_a_tangent_by_threads_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice, as what the threads add to is kept; and with a pattern of more entries in between."""
    solids = small_solids(cells=7)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    wanted = tangent_of(solids)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert solids._threads() == 3
    for _ in range(2):
        # the order of up to 24 tets' parts of an entry, as in test_assembly_equals_scipys
        assert abs(tangent_of(solids) - wanted).max() <= 150 * EPS * abs(wanted).max()
    assert len(solids._apart) == 2
    more = np.union1d(solids.keys, pair_keys(np.array([0], np.int32), np.array([solids.node_count - 1], np.int32), solids.node_count))
    pattern = build_pattern(solids.free, more, "cpu")
    values = wp.zeros(len(pattern.indices), dtype=wp.float64, device="cpu")
    solids.add_tangent(pattern.pairs, values)
    upper = sp.csr_matrix((values.numpy(), pattern.indices, pattern.indptr), shape=wanted.shape)
    assert abs(upper - sp.triu(wanted)).max() <= 150 * EPS * abs(wanted).max()
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert solids._threads() == 1
    monkeypatch.delenv("OMP_NUM_THREADS")
    assert small_solids()._threads() == 1, "too few tets"


def test_pattern_is_the_upper_triangle_sorted() -> None:
    rng = np.random.default_rng(4)
    free = rng.random((12, 4)) < 0.6
    free[3] = False  # a node without unknowns, like one of a rigid surface
    a, b = rng.integers(0, 12, 30), rng.integers(0, 12, 30)
    keys = np.unique(pair_keys(a[a != b].astype(np.int32), b[a != b].astype(np.int32), 12))
    pattern = build_pattern(free, keys, "cpu")
    nodes = np.zeros((12, 12), bool)
    nodes[keys // 12, keys % 12] = True
    nodes |= nodes.T | np.eye(12, dtype=bool)
    owner = np.nonzero(free)[0]
    wanted = sp.csr_matrix(np.triu(nodes[np.ix_(owner, owner)]))
    wanted.sort_indices()
    assert np.array_equal(pattern.indptr, wanted.indptr)
    assert np.array_equal(pattern.indices, wanted.indices)
    assert np.array_equal(pattern.equation[free], np.arange(free.sum()))


def test_element_pairs_are_those_that_share_a_tet() -> None:
    tets = np.array([[0, 1, 2, 3], [3, 2, 1, 4]], np.int32)
    keys = element_pairs(tets, 5)
    assert [(int(k) // 5, int(k) % 5) for k in keys] == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (1, 4), (2, 3), (2, 4), (3, 4)]


def solved(solver: PardisoSolver | SuperLUSolver, solids: Solids, right: Array) -> Array:
    pattern = build_pattern(solids.free, solids.keys, "cpu")
    values = wp.zeros(len(pattern.indices), dtype=wp.float64, device="cpu")
    solids.add_tangent(pattern.pairs, values)
    solver.analyse(pattern.indptr, pattern.indices, np.zeros(len(pattern.indices)))
    solver.factorise(values.numpy())
    return solver.solve(right)


@pytest.mark.parametrize("nu", [0.3, 0.499, 0.49999])
def test_solvers_agree(nu: float) -> None:
    solids = small_solids(nu)
    right = np.random.default_rng(6).standard_normal(solids.unknowns)
    matrix = tangent_of(solids)
    answers = [solved(SuperLUSolver(), solids, right)]
    if find_mkl() is not None:
        answers.append(solved(PardisoSolver(threads=1), solids, right))
    condition = np.linalg.cond(matrix.toarray())
    for x in answers:
        # a backward stable solution: the residual is a few roundings of |K| |x|, the error that times the condition (3e5 here)
        assert np.linalg.norm(matrix @ x - right) <= 10 * EPS * (sp.linalg.norm(matrix) * np.linalg.norm(x))
        assert np.linalg.norm(x - answers[0]) <= 20 * EPS * condition * np.linalg.norm(answers[0])
    assert np.linalg.norm(answers[0]) > 0


@pytest.mark.parametrize("kind", [SuperLUSolver, pytest.param(PardisoSolver, marks=needs_mkl)])
def test_products_are_of_the_whole_matrix(kind: type[SuperLUSolver | PardisoSolver]) -> None:
    solids = small_solids()
    pattern = build_pattern(solids.free, solids.keys, "cpu")
    values = wp.zeros(len(pattern.indices), dtype=wp.float64, device="cpu")
    solids.add_tangent(pattern.pairs, values)
    solver = kind()
    solver.analyse(pattern.indptr, pattern.indices, values.numpy())
    product, whole = solver.product(values.numpy()), tangent_of(solids).toarray()
    rng = np.random.default_rng(3)
    for x in (rng.standard_normal(pattern.size), rng.standard_normal(2 * pattern.size)[::2], rng.integers(-3, 3, pattern.size, np.int8)):
        # a row has a hundred entries
        assert np.abs(product(x) - whole @ x).max() <= 100 * EPS * (np.abs(whole) @ np.abs(x)).max()
    with pytest.raises(ValueError, match=str(pattern.size)):  # not memory beyond the vector
        product(x[:-1])


def test_system_with_the_unsymmetric_part_of_friction() -> None:
    """(K + B_tᵀ B_n) x = b, by GMRES around the factorised K."""
    solids = small_solids()
    pattern = build_pattern(solids.free, solids.keys, "cpu")
    values = wp.zeros(len(pattern.indices), dtype=wp.float64, device="cpu")
    solids.add_tangent(pattern.pairs, values)
    with float64_factors():
        system = SymmetricSystem()
    system.analyse(pattern.indptr, pattern.indices)
    system.update(values.numpy())
    system.factorise()
    rng = np.random.default_rng(12)
    right = rng.standard_normal(pattern.size)
    along, closing = (sp.csr_matrix(np.where(rng.random((3, pattern.size)) < 0.1, rng.random((3, pattern.size)), 0.0)) for _ in range(2))
    whole = tangent_of(solids).toarray()
    plain = np.linalg.solve(whole, right)
    assert np.linalg.norm(system.solve(right, None) - plain) <= 1e-9 * np.linalg.norm(plain)  # condition 3e5 times rounding
    wanted = np.linalg.solve(whole + (along.T @ closing).toarray(), right)
    found = system.solve(right, lambda v: along.T @ (closing @ v))
    assert np.linalg.norm(wanted - plain) > 0.1 * np.linalg.norm(plain), "a coupling that does nothing would prove nothing"
    # of rank 3: GMRES would end exactly after four steps; it may stop at its tolerance before, in the preconditioned residual
    assert np.linalg.norm(found - wanted) <= 10 * SymmetricSystem.KRYLOV_TOLERANCE * np.linalg.norm(wanted)
    assert system.factorisations == 1
    assert np.linalg.norm(system.product(plain) - whole @ plain) <= 1e-12 * np.linalg.norm(right)


def test_rough_steps_on_factors_of_an_earlier_matrix() -> None:
    """GMRES on old factors answers a matrix near theirs; far from theirs new ones are made, and after a laborious step for the next."""
    solids = small_solids()
    pattern = build_pattern(solids.free, solids.keys, "cpu")
    values = wp.zeros(len(pattern.indices), dtype=wp.float64, device="cpu")
    solids.add_tangent(pattern.pairs, values)
    first = values.numpy()
    rng = np.random.default_rng(4)
    none = sp.csr_matrix((0, pattern.size))

    def whole(values: np.ndarray) -> np.ndarray:
        upper = sp.csr_matrix((values, pattern.indices, pattern.indptr), shape=(pattern.size, pattern.size)).toarray()
        return upper + np.triu(upper, 1).T

    right = whole(first) @ rng.standard_normal(pattern.size)
    with float64_factors():
        system = SymmetricSystem()
    system.analyse(pattern.indptr, pattern.indices)
    system.update(first)
    system.step(right, lambda v: none.T @ (none @ v), exact=False)
    assert system.factorisations == 1, "there were no factors"

    diagonal = pattern.indptr[:-1]
    near = first.copy()
    near[diagonal[np.argsort(first[diagonal])[-3:]]] *= 3.0  # of rank 3: four products at most
    system.update(near)
    x = system.step(right, None, exact=False)
    assert system.factorisations == 1
    # what is left, seen through the old factors
    old = np.linalg.inv(whole(first))
    assert np.linalg.norm(old @ (right - whole(near) @ x)) <= 1.01 * SymmetricSystem.FORCING * np.linalg.norm(old @ right)
    assert np.linalg.norm(old @ (right - whole(near) @ (old @ right))) > 0.1 * np.linalg.norm(old @ right), "the old answer would have done"

    exact = np.linalg.solve(whole(near), right)
    assert np.linalg.norm(system.step(right, None, exact=True) - exact) <= 1e-9 * np.linalg.norm(exact)
    assert system.factorisations == 2

    far = first.copy()
    far[diagonal] *= np.geomspace(1.0, 1e3, pattern.size)
    system.update(far)
    x = system.step(right, None, exact=False)
    assert system.factorisations == 3, "GMRES cannot have got there in twelve steps"
    assert np.linalg.norm(whole(far) @ x - right) <= 1e-9 * np.linalg.norm(whole(far), 2) * np.linalg.norm(x)


def test_gmres_of_so_many_products() -> None:
    """Against the least residual in the Krylov space, found by least squares; its own account of what is left is right."""
    rng = np.random.default_rng(5)
    matrix = np.eye(30) + 0.4 * rng.standard_normal((30, 30)) / np.sqrt(30)
    right, asked = rng.standard_normal(30), []

    def product(x: Array) -> Array:
        asked.append(x)
        return matrix @ x

    space = [right]
    for _ in range(4):
        space.append(matrix @ space[-1])
    best = np.linalg.lstsq(matrix @ np.array(space).T, right, rcond=None)[0] @ np.array(space)
    x, enough = gmres(product, right, 1e-9, 5)
    assert len(asked) == 5 and not enough
    assert np.linalg.norm(x - best) <= 1e-10 * np.linalg.norm(best)  # the space's condition is 1e3
    asked.clear()
    x, enough = gmres(product, right, 1e-3, 20)
    assert enough and len(asked) < 20
    assert 1e-6 * np.linalg.norm(right) < np.linalg.norm(right - matrix @ x) <= 1e-3 * np.linalg.norm(right)
    assert np.array_equal(gmres(np.zeros_like, right, 1e-3, 20)[0], np.zeros(30)), "a singular matrix has no answer, and no error"


def test_factors_wear_out_where_new_ones_cost_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """A factorisation as dear as six products: after steps of 2, 3, 4, 5 and 6 products, 26 in all, the sixth of them or 5.2 are less."""
    system = SymmetricSystem()
    system.analyse(np.arange(3, dtype=np.int32), np.arange(2, dtype=np.int32))
    system.direct.cost = 6.0 * SymmetricSystem.PER_ENTRY
    products = iter((2, 3, 4, 5, 6))

    def taking(product: Product, b: Array, tolerance: float, limit: int) -> tuple[Array, bool]:
        for _ in range(next(products) - 1):
            product(b)
        return b, True

    system.update(np.ones(2))
    system.step(np.ones(2), None, exact=False)
    monkeypatch.setattr(linear, "gmres", taking)
    worn = []
    for _ in range(5):
        system.update(np.ones(2))
        system.step(np.ones(2), None, exact=False)
        worn.append(system._worn)
    assert worn == [False, False, False, False, True]
    system.update(np.ones(2))
    system.step(np.ones(2), None, exact=False)
    assert system.factorisations == 2


@needs_mkl
def test_cost_of_a_factorisation() -> None:
    """LDLᵀ of a full matrix takes n³/3 operations (multiplication and addition) on its n²/2 entries, and a factor has as many."""
    n = 1200
    rows = sp.csr_matrix(np.triu(np.ones((n, n))))
    system = SymmetricSystem()
    system.analyse(rows.indptr.astype(np.int32), rows.indices.astype(np.int32))
    assert system.direct.cost == pytest.approx(n / 3, rel=0.1)  # diagonal blocks are counted whole: 7 % more entries, 9 % more operations


@needs_mkl
def test_float32_factors_are_backward_stable() -> None:
    solids = small_solids(0.4999)
    right = np.random.default_rng(6).standard_normal(solids.unknowns)
    matrix = tangent_of(solids)
    x = solved(PardisoSolver(threads=1, single=True), solids, right)
    rounding = np.linalg.norm(matrix @ x - right) / (sp.linalg.norm(matrix) * np.linalg.norm(x))
    # the bound of the float64 test in float32's rounding; and it must be float32, or nothing was saved
    assert 100 * EPS < rounding <= 10 * np.finfo(np.float32).eps


@needs_mkl
def test_a_poor_float32_factor_is_replaced() -> None:
    """A chain of springs, the softest of 1 among many of 1e9: in float32 1e9 + 1 is 1e9."""
    count = 40
    stiffness = np.full(count, 1e9)
    stiffness[0] = 1.0
    chain = sp.diags([stiffness + np.append(stiffness[1:], 0.0), -stiffness[1:]], [0, 1], format="csr")
    right = np.ones(count)
    whole = chain.toarray()
    whole = whole + np.triu(whole, 1).T
    system = SymmetricSystem()
    system.analyse(chain.indptr.astype(np.int32), chain.indices.astype(np.int32))
    system.update(chain.data)
    system.factorise()
    assert system.direct.single
    # float64's rounding times the condition, 1e9·40²; all of the load goes through the soft spring, so x is count/1 and a little more
    x = system.solve(right, None)
    assert np.abs(x - count).max() <= 1e-3 * count
    assert np.linalg.norm(whole @ x - right) <= 10 * EPS * np.linalg.norm(whole) * np.linalg.norm(x)
    assert not system.direct.single
    assert system.factorisations == 2
    with float64_factors():
        assert not SymmetricSystem().direct.single


def test_a_solver_without_mkl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gelsim.fem.linear.find_mkl", lambda: None)
    assert isinstance(make_solver(), SuperLUSolver)


@needs_mkl
def test_an_exact_step_of_a_saddle_goes_downhill() -> None:
    """A body that folds: two springs of 1, coupled by 1.02, are of stiffness 2.02 and -0.02, in which the matrix's step is uphill."""
    matrix = np.diag([1.0, 1.0, 1.0, 3.0, -1.0])
    matrix[0, 1] = matrix[1, 0] = 1.02
    matrix[2, 4] = matrix[4, 2] = 0.5
    whole = sp.csr_matrix(np.triu(matrix) + np.triu(np.full((5, 5), 1e-9), 1))
    b, steps = np.array([1.0, -1.0, 0.1, 0.1, 0.0]), []
    for positive in (None, np.arange(5) < 4):
        system = SymmetricSystem(positive)
        system.analyse(whole.indptr.astype(np.int32), whole.indices.astype(np.int32))
        system.update(whole.data)
        steps.append(system.step(b, None, exact=True))
    assert b @ steps[0] == pytest.approx(2 / -0.02, rel=1e-2)
    # a shift of 0.008 is too little, of 0.06 it is enough: 2/(0.06 - 0.02), and 0.1²/1.3 + 0.1²/3 of the others
    assert b @ steps[1] == pytest.approx(2 / 0.04, rel=1e-2)
    assert system.factorisations == 4
    # where 0.008 is too little again, so is none
    system.update(whole.data)
    assert system.step(b, None, exact=True) == pytest.approx(steps[1]) and system.downhill
    assert system.factorisations == 4 + 2
    # with 0.98 for 1.02 it is a minimum: its own step, 2/0.02
    matrix[0, 1] = 0.98
    system.update(sp.csr_matrix(np.triu(matrix) + np.triu(np.full((5, 5), 1e-9), 1)).data)
    assert b @ system.step(b, None, exact=True) == pytest.approx(2 / 0.02, rel=1e-2) and not system.downhill
    assert system.factorisations == 4 + 2 + 2


@needs_mkl
def test_an_exact_step_leads_down_where_slip_leads_up_and_not_beyond_its_reach() -> None:
    """Two springs of 1; by C, which no eigenvalue of K tells of, the first one is of stiffness -0.5: its own step would go up by 2."""
    whole = sp.csr_matrix(np.diag([1.0, 1.0, -1.0]))
    whole.sort_indices()
    b = np.array([1.0, 0.1, 0.0])

    def slips(v: np.ndarray) -> np.ndarray:
        return np.array([-1.5 * v[0], 0.0, 0.0])

    def system() -> SymmetricSystem:
        made = SymmetricSystem(np.arange(3) < 2)
        made.analyse(whole.indptr.astype(np.int32), whole.indices.astype(np.int32))
        made.update(whole.data)
        return made

    one = system()
    one.factorise()
    assert one.solve(b, slips)[0] == pytest.approx(-2.0), "the fault: Newton's own step"
    one = system()
    assert one.step(b, slips, exact=True)[:2] == pytest.approx([1.0, 0.1])
    assert one.downhill and one.factorisations == 1
    # shifts of 0.001, 0.008, 0.06 leave more than 0.9 of the step, one of 0.5 leaves 1/1.5
    one = system()
    assert one.step(b, None, exact=True, reach=0.9)[:2] == pytest.approx(np.array([1.0, 0.1]) / 1.5)
    assert one.downhill and one.factorisations == 1 + 4
    one = system()
    assert one.step(b, None, exact=True, reach=1.01)[0] == pytest.approx(1.0) and not one.downhill


def test_a_singular_matrix_has_no_answer() -> None:
    """Not an error that ends a worker: Newton takes what is not finite for a step that failed."""
    solver = SuperLUSolver()
    matrix = np.array([[1.0, 2.0], [2.0, 4.0]])
    indptr, indices = np.array([0, 2, 3], np.int32), np.array([0, 1, 1], np.int32)
    solver.analyse(indptr, indices, np.zeros(3))
    solver.factorise(np.array([1.0, 2.0, 4.0]))
    assert np.isnan(solver.solve(matrix @ np.ones(2))).all()
    solver.factorise(np.array([1.0, 2.0, 5.0]))
    assert solver.solve(np.array([3.0, 7.0])) == pytest.approx(1.0)


@pytest.mark.parametrize("batched", [False, True])
def test_a_press_whose_matrices_are_singular_is_lost(monkeypatch: pytest.MonkeyPatch, batched: bool) -> None:
    def singular(*_: object, **__: object) -> None:
        raise RuntimeError("Factor is exactly singular")

    monkeypatch.setattr(linear, "make_solver", lambda single=False: SuperLUSolver())
    scene = ball_scene(0.3, 2, radius_mm=5.0)
    gel = flat_gel(3.0, 4.0, 2, 6.0, 3.0)
    problem = problem_of(scene, gel, rigid_body(scene, gel))  # contact projects by a factor of its own
    monkeypatch.setattr("scipy.sparse.linalg.splu", singular)
    press = run_batch([problem])[0] if batched else run_press(problem, throw=False)
    assert press.lost and len(press.approach) == 1


@needs_mkl
@pytest.mark.parametrize(("said", "layer"), [({"OMP_NUM_THREADS": "1"}, "SEQUENTIAL"), ({"OMP_NUM_THREADS": "2"}, "TBB"), ({}, "TBB")])
def test_one_thread_is_one(said: dict[str, str], layer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """TBB heeds neither variable. A worker of one thread takes one, whatever its parent chose."""
    monkeypatch.setattr(linear.os, "environ", said | {})
    PardisoSolver()
    assert linear.os.environ["MKL_THREADING_LAYER"] == layer
    assert (linear.os.environ | settings(1))["MKL_THREADING_LAYER"] == "SEQUENTIAL"
