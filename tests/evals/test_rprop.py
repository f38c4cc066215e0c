"""The two Rprop engines against closed forms, against autograd, and against each other."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from steerkit._support.native import NoCompilerError
from steerkit.learning.nfq import rprop
from steerkit.learning.nfq.rprop import fit, flat, forward, new_net, predictor, shaped, sizes_of

LAYOUTS = [(7, 10, 10, 1), (3, 1), (2, 4, 1), (5, 11, 3, 7, 1), (1, 6, 8, 1)]


def _has_c() -> bool:
    try:
        rprop.library()
    except NoCompilerError:
        return False
    return True


needs_c = pytest.mark.skipif(not _has_c(), reason="no C compiler here")
engines = pytest.mark.parametrize("engine", [pytest.param("c", marks=needs_c), "torch"])


def data(sizes: tuple[int, ...], n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, (n, sizes[0])).astype(np.float32)
    return x, (0.5 + 0.4 * np.sin(3.0 * x[:, 0] + x[:, -1])).astype(np.float32)


@needs_c
def test_sigmoid_is_accurate_relatively_over_its_whole_range() -> None:
    z = np.linspace(-41.0, 41.0, 400_001, dtype=np.float32)
    net = (np.ones((1, 1), np.float32), np.zeros(1, np.float32))
    true = 1.0 / (1.0 + np.exp(-z.astype(np.float64)))
    q = predictor(net, 1, engine="c")(z[:, None])
    assert np.all(np.abs(q / true - 1.0) < 3e-7 + 7e-8 * np.abs(z))
    assert np.max(np.abs(q - true)) < 2e-7
    assert np.all(q >= 0.0)
    assert np.all(q <= 1.0)


@needs_c
@pytest.mark.parametrize("sizes", LAYOUTS)
def test_predict_equals_numpy_for_every_filling_of_the_last_block(sizes: tuple[int, ...]) -> None:
    net = new_net(sizes, seed=1)
    x, _ = data(sizes, 300)
    true = forward(net, x.astype(np.float64))
    for n in (0, 1, 2, 15, 16, 17, 127, 128, 129, 256, 300):
        np.testing.assert_allclose(predictor(net, sizes[0], engine="c")(x[:n]), true[:n], atol=3e-7)


@engines
def test_steps_grow_by_eta_plus_while_the_gradient_keeps_its_sign(engine: rprop.Engine) -> None:
    """One unit, x = 1, target 1: both weights climb by 0.1 * 1.2^k, so w_k = w_0 + 0.1 (1.2^k - 1) / 0.2."""
    net = (np.zeros((1, 1), np.float32), np.zeros(1, np.float32))
    for k in (0, 1, 2, 10):
        (w, b), _ = fit(net, np.ones((1, 1), np.float32), np.ones(1, np.float32), epochs=k, engine=engine)
        assert w[0, 0] == pytest.approx(0.5 * (1.2**k - 1.0), abs=1e-5)
        assert b[0] == w[0, 0]


@engines
def test_a_turn_costs_half_the_step_and_one_epoch_of_rest(engine: rprop.Engine) -> None:
    """One unit, x = 1, the optimum at w + b = 0.15 from w = b = 0: each moves 0.1 (too far), rests, then -0.05."""
    net = (np.zeros((1, 1), np.float32), np.zeros(1, np.float32))
    target = np.array([1.0 / (1.0 + np.exp(-0.15))], np.float32)
    walk = [fit(net, np.ones((1, 1), np.float32), target, epochs=k, engine=engine).net[1][0] for k in range(4)]
    assert walk == pytest.approx([0.0, 0.1, 0.1, 0.05], abs=1e-6)


@engines
def test_a_step_never_leaves_its_limits(engine: rprop.Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rprop, "RULE", (0.1, 0.5, 1.2, 1e-6, 0.11))
    net = (np.zeros((1, 1), np.float32), np.zeros(1, np.float32))
    one = np.ones((1, 1), np.float32)
    (w, _), _ = fit(net, one, np.ones(1, np.float32), epochs=5, engine=engine)
    assert w[0, 0] == pytest.approx(0.1 + 4 * 0.11, abs=1e-6)


@needs_c
@pytest.mark.parametrize("sizes", [(7, 10, 10, 1), (2, 4, 1)])
def test_weights_follow_torch_in_double_precision_step_by_step(sizes: tuple[int, ...]) -> None:
    net = new_net(sizes, seed=3)
    x, y = data(sizes, 200)
    double = tuple(p.astype(np.float64) for p in net)
    for epochs in (1, 2, 3, 5, 8, 13):
        ours, errors = fit(net, x, y, epochs=epochs, engine="c")
        reference, true = fit(double, x, y, epochs=epochs, engine="torch")
        np.testing.assert_allclose(flat(ours), flat(reference), atol=2e-6)
        np.testing.assert_allclose(errors, true, rtol=1e-5)


@engines
def test_equal_arguments_give_equal_bits_on_any_thread(engine: rprop.Engine) -> None:
    net, (x, y) = new_net(seed=5), data((7, 10, 10, 1), 1000)
    with ThreadPoolExecutor(2) as pool:
        runs = list(pool.map(lambda _: flat(fit(net, x, y, epochs=40, engine=engine).net), range(3)))
    assert all(np.array_equal(runs[0], other) for other in runs)
    assert not np.array_equal(runs[0], flat(net))


def test_flat_and_shaped_are_inverse() -> None:
    net = new_net((5, 11, 3, 1), seed=2)
    again = shaped(flat(net), sizes_of(net))
    assert all(np.array_equal(a, b) for a, b in zip(net, again, strict=True))
    assert max(np.abs(p).max() for p in net) <= 0.5


@engines
@pytest.mark.parametrize("which", ["x", "target"])
def test_nan_is_refused(engine: rprop.Engine, which: str) -> None:
    x, y = data((7, 10, 10, 1), 10)
    (x if which == "x" else y)[3] = np.nan
    with pytest.raises(ValueError, match=f"{which} holds a NaN"):
        fit(new_net(), x, y, epochs=1, engine=engine)


def test_wrong_shapes_are_refused() -> None:
    x, y = data((7, 10, 10, 1), 10)
    with pytest.raises(ValueError, match=r"expected \(n, n_in\) and \(n,\)"):
        fit(new_net(), x, y[:-1], epochs=1)
    with pytest.raises(ValueError, match=r"W \(10, 7\).*expected W \(n_out, 5\)"):
        fit(new_net(), x[:, :5], y, epochs=1)
    with pytest.raises(ValueError, match="valid: 'auto', 'c', 'torch'"):
        fit(new_net(), x, y, engine="gpu")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="epochs = -1, expected >= 0"):
        fit(new_net(), x, y, epochs=-1)
    with pytest.raises(ValueError, match="n >= 1"):
        fit(new_net(), x[:0], y[:0])
    for sizes in ((7,), (7, 0, 1)):
        with pytest.raises(ValueError, match="expected two or more, each >= 1"):
            new_net(sizes)


def test_without_a_compiler_torch_takes_over_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    rprop.library.cache_clear()
    rprop._auto.cache_clear()
    monkeypatch.setenv("CC", "/nowhere/cc")
    try:
        with pytest.warns(RuntimeWarning, match="PyTorch.*nowhere"):
            assert rprop.engine_of("auto") == "torch"
        with pytest.raises(NoCompilerError):
            rprop.fit(new_net(), *data((7, 10, 10, 1), 5), epochs=1, engine="c")
    finally:
        rprop.library.cache_clear()
        rprop._auto.cache_clear()
