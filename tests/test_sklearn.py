from __future__ import annotations

import pickle
import subprocess
import sys

import numpy as np
import pytest

import leastaction as la
from leastaction import systems
from leastaction.errors import DataError, InputError

sklearn = pytest.importorskip("sklearn")

from sklearn.base import clone  # noqa: E402
from sklearn.exceptions import NotFittedError  # noqa: E402
from sklearn.model_selection import GridSearchCV, KFold, cross_val_score  # noqa: E402
from sklearn.utils.estimator_checks import parametrize_with_checks  # noqa: E402

LIBRARY = ["theta_dot**2", "cos(theta)", "sin(theta)", "theta_dot**4"]
NEEDS_TIMES = "y are random labels; here the second argument is the times, which must increase: "
EXPECTED_FAILURES = {
    "check_fit_score_takes_y": "the second argument is called t: it is the times, not a target",
    **dict.fromkeys(
        (
            "check_estimators_overwrite_params",
            "check_dont_overwrite_parameters",
            "check_dict_unchanged",
            "check_estimators_fit_returns_self",
            "check_n_features_in",
            "check_n_features_in_after_fitting",
            "check_fit_check_is_fitted",
        ),
        NEEDS_TIMES + "see test_what_fit_leaves_behind",
    ),
    **dict.fromkeys(
        (
            "check_readonly_memmap_input",
            "check_estimators_dtypes",
            "check_dtype_object",
            "check_f_contiguous_array_estimator",
        ),
        NEEDS_TIMES + "see test_kinds_of_arrays",
    ),
    "check_estimators_pickle": NEEDS_TIMES + "see test_pickle_and_clone",
    "check_fit_idempotent": NEEDS_TIMES + "see test_fit_twice",
    "check_pipeline_consistency": NEEDS_TIMES + "see test_pipeline",
    "check_positive_only_tag_during_fit": NEEDS_TIMES + "all tests here have negative angles",
    "check_methods_sample_order_invariance": NEEDS_TIMES + "see test_predict_row_by_row",
    "check_methods_subset_invariance": NEEDS_TIMES + "see test_predict_row_by_row",
    "check_fit2d_predict1d": NEEDS_TIMES + "and predict takes one state of shape (n_dof,)",
    "check_estimators_empty_data_messages": "says that a trajectory has no times, not 'features'",
    "check_fit2d_1feature": NEEDS_TIMES + "one coordinate is the commonest case and works",
}


@parametrize_with_checks([la.SparseLagrangian()], expected_failed_checks=lambda estimator: EXPECTED_FAILURES)
def test_scikit_learn_checks(estimator, check):
    check(estimator)


@pytest.fixture(scope="module")
def runs():
    return systems.generate("single_pendulum", noise=0.01, trials=4, duration=4.0, rate=50.0, seed=0)


@pytest.fixture(scope="module")
def fitted(runs):
    return la.SparseLagrangian(LIBRARY).fit(runs)


def passive(**options):
    """Undriven pendulum and cart: arrays and times without forces."""
    return systems.generate("cart_spring_pendulum", noise=0.01, trials=3, duration=6.0, seed=1, **options)


CART = {
    "library": ["x_dot**2", "theta_dot**2", "x_dot*theta_dot*cos(theta)", "x", "x**2", "cos(theta)"],
    "known": {"cos(theta)": 9.81},
    "coordinates": ["x", "theta"],
}


def test_importing_the_package_does_not_import_scikit_learn():
    code = "import sys, leastaction, leastaction.cli; leastaction.discover; print('sklearn' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.split() == ["False"]


def test_without_scikit_learn_the_message_names_the_extra():
    code = (
        "import sys; sys.modules['sklearn'] = None; sys.modules['sklearn.base'] = None\n"
        "import leastaction\n"
        "try: leastaction.SparseLagrangian\n"
        "except ImportError as error: print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert "leastaction[sklearn]" in done.stdout


def test_it_is_discover(runs, fitted):
    model = la.discover(runs, LIBRARY)
    assert fitted.model_.to_dict() == model.to_dict()
    np.testing.assert_array_equal(fitted.coef_, [t.coefficient for t in model.terms])
    assert fitted.coordinates_ == ("theta",)
    q, v, f = np.array([[0.3], [-1.0]]), np.array([[0.5], [0.1]]), np.array([[0.2], [0.0]])
    np.testing.assert_array_equal(fitted.predict(q, v, f), model.acceleration(q, v, f))
    np.testing.assert_array_equal(fitted.predict(q), model.acceleration(q, 0 * q))
    t = np.linspace(0.0, 2.0, 50)
    ours, theirs = fitted.simulate([0.3], [0.0], t), model.simulate([0.3], [0.0], t)
    np.testing.assert_array_equal(ours.q, theirs.q)


def test_arguments_reach_discover(runs):
    options = {
        "known": {"theta_dot**2": 0.5},
        "dissipation": ["theta_dot**2/2"],
        "relevance": 0.01,
        "seed": 3,
    }
    model = la.SparseLagrangian(LIBRARY, degree=4, angles=["theta"], **options).fit(runs).model_
    given = model.provenance["options"]
    assert {name: given[name] for name in options} == options
    assert (given["degree"], given["angles"], given["method"]) == (4, ["theta"], "gauss-newton")


@pytest.mark.thorough
def test_arrays_and_trajectories_give_the_same(runs, fitted):
    """One list of trajectories, given in every way that is promised."""
    q, t, forces = [r.q for r in runs], [r.t for r in runs], [r.forces for r in runs]
    estimator = la.SparseLagrangian(LIBRARY, coordinates=["theta"])
    ways = [
        (list(runs),),
        (tuple(runs),),
        (q, t, forces),
        (q, t[0], forces),
        (q, 0.02, forces),
        (np.array(q), np.array(t), np.array(forces)),
        (np.array(q), t[0], forces),
        ([x[:, 0] for x in q], t, [f[:, 0] for f in forces]),
        (q, t[0].tolist(), forces),
        (q, np.float64(0.02), forces),
    ]
    for way in ways:
        np.testing.assert_allclose(estimator.fit(*way).coef_, fitted.coef_, rtol=1e-6)
    shared = clone(estimator).fit(q, t, forces[0])
    same = [la.Trajectory(a, x, forces[0], ["theta"]) for a, x in zip(t, q, strict=True)]
    np.testing.assert_array_equal(shared.coef_, estimator.fit(same).coef_)
    one = clone(estimator).fit(q[0], t[0].tolist(), forces[0].tolist())
    np.testing.assert_array_equal(one.coef_, estimator.fit(runs[0]).coef_)
    assert one.n_features_in_ == 1


def test_trajectories_of_different_lengths_and_forces():
    data = passive()
    q = [data[0].q, data[1].q[:450], data[2].q]
    t = [run.t[: len(x)] for run, x in zip(data, q, strict=True)]
    estimator = la.SparseLagrangian(**CART).fit(q, t)
    assert estimator.n_features_in_ == 2
    again = clone(estimator).fit(q, t, [None, np.zeros_like(q[1]), None])
    np.testing.assert_array_equal(again.coef_, estimator.coef_)
    assert estimator.model_.fit.status == "ok"


@pytest.mark.thorough
def test_library_by_default():
    data = passive()
    estimator = la.SparseLagrangian(known={"cos(theta)": 9.81}, angles=["theta"]).fit(data)
    library = la.Library.mechanical(["x", "theta"], angles=["theta"])
    model = la.discover(data, library, known={"cos(theta)": 9.81}, angles=["theta"])
    assert estimator.model_.to_dict() == model.to_dict()


def test_library_brings_the_names_of_the_columns():
    data = passive()
    library = la.Library(CART["library"], coordinates=["x", "theta"])
    estimator = la.SparseLagrangian(library, CART["known"]).fit([r.q for r in data], [r.t for r in data])
    assert estimator.coordinates_ == ("x", "theta")
    nameless = la.SparseLagrangian(["q1_dot**2", "q1**2"], {"q1_dot**2": 0.5})
    t = np.linspace(0.0, 8.0, 200)
    assert nameless.fit(np.cos(t)[:, None], t).coordinates_ == ("q1",)


# --------------------------------------------------------------------------------- protocol
def test_what_fit_leaves_behind(runs):
    estimator = la.SparseLagrangian(LIBRARY)
    before = dict(estimator.get_params())
    with pytest.raises(NotFittedError):
        estimator.score(runs)
    assert estimator.fit(runs) is estimator
    assert estimator.get_params() == before
    public = {name for name in vars(estimator) if name not in before}
    assert all(name.endswith("_") for name in public)
    assert estimator.n_features_in_ == 1
    state = dict(vars(estimator))
    estimator.predict([[0.1]])
    estimator.score(runs)
    assert vars(estimator) == state


@pytest.mark.thorough
def test_kinds_of_arrays(tmp_path):
    data = passive()
    q, t = np.array([r.q for r in data]), data[0].t
    estimator = la.SparseLagrangian(**CART).fit(q, t)
    mapped = np.memmap(tmp_path / "q", dtype=float, mode="w+", shape=q.shape)
    mapped[:] = q
    mapped.flags.writeable = False
    for other in (np.asfortranarray(q), mapped, q.astype(object), q.astype(np.longdouble), q.tolist()):
        np.testing.assert_array_equal(clone(estimator).fit(other, t).coef_, estimator.coef_)
    single = clone(estimator).fit(q.astype(np.float32), t)
    np.testing.assert_allclose(single.coef_, estimator.coef_, rtol=1e-3)


def test_pickle_and_clone(runs, fitted):
    again = pickle.loads(pickle.dumps(fitted))
    q = np.linspace(-1.0, 1.0, 7)[:, None]
    np.testing.assert_array_equal(again.predict(q), fitted.predict(q))
    assert again.score(runs) == fitted.score(runs)
    copy = clone(fitted.set_params(horizon=0.5))
    fitted.set_params(horizon=None)
    assert copy.horizon == 0.5
    assert not hasattr(copy, "model_")


def test_fit_twice(runs, fitted):
    first = fitted.coef_.copy()
    np.testing.assert_array_equal(fitted.fit(runs).coef_, first)


def test_predict_row_by_row(fitted):
    rng = np.random.default_rng(1)
    q, v = rng.uniform(-2.0, 2.0, (2, 10, 1))
    whole = fitted.predict(q, v)
    np.testing.assert_allclose([fitted.predict(a, b) for a, b in zip(q, v, strict=True)], whole, rtol=1e-14)
    np.testing.assert_allclose(fitted.predict(q[::-1], v[::-1]), whole[::-1], rtol=1e-14)


def test_pipeline(runs, fitted):
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import FunctionTransformer

    pipeline = make_pipeline(FunctionTransformer(), la.SparseLagrangian(LIBRARY)).fit(list(runs))
    assert pipeline.score(list(runs)) == fitted.score(runs)


# ------------------------------------------------------------------------------------- score
def test_score_is_r2_of_the_forecasts(runs, fitted):
    result = fitted.model_.validate(runs)
    measured = np.concatenate([trace.measured for trace in result.traces])
    forecast = np.concatenate([trace.forecast for trace in result.traces])
    expected = sklearn.metrics.r2_score(measured, forecast)
    assert fitted.score(runs) == pytest.approx(expected, rel=1e-12)
    assert 0.99 < expected < 1.0


def test_score_without_times_uses_those_that_the_trajectories_of_fit_shared(runs, fitted):
    q, t, forces = [r.q for r in runs], [r.t for r in runs], [r.forces for r in runs]
    estimator = la.SparseLagrangian(LIBRARY, coordinates=["theta"])
    for shared in (0.02, t[0]):
        estimator.fit(q, shared, forces)
        assert np.all(estimator.t_ == shared)
        assert estimator.score(q, forces=forces) == pytest.approx(fitted.score(runs), rel=1e-6)
    assert estimator.fit(q, t, forces).t_ is None
    with pytest.raises(InputError, match="t is missing"):
        estimator.score(q, forces=forces)


def test_score_leaves_missing_samples_out(runs, fitted):
    holes = []
    for run in runs:
        q = run.q.copy()
        q[::7] = np.nan
        holes.append(la.Trajectory(run.t, q, run.forces, run.coordinates))
    assert fitted.score(holes) == pytest.approx(fitted.score(runs), abs=1e-3)


def test_score_of_a_wrong_model_is_lower_and_of_one_that_diverges_finite(runs, fitted):
    wrong = clone(fitted).fit(runs)
    wrong.model_ = la.LagrangianModel(
        ["theta"],
        [
            type(fitted.model_.terms[0])("theta_dot**2", 0.5),
            type(fitted.model_.terms[0])("cos(theta)", -9.81),
        ],
    )
    upside_down = wrong.score(runs)
    assert -99.0 <= upside_down < 0.9 < fitted.score(runs)
    wrong.model_ = la.LagrangianModel(
        ["theta"],
        [
            type(fitted.model_.terms[0])("theta_dot**2", 0.5),
            type(fitted.model_.terms[0])("theta**4", 1e5),
        ],
    )
    assert -99.0 - 1e-9 <= wrong.score(runs) < upside_down


def test_horizon_is_used(runs, fitted):
    assert fitted.model_.validate(runs, 0.5).horizon == 0.5
    short = clone(fitted).set_params(horizon=0.5).fit(runs)
    measured, forecast = (
        np.concatenate([getattr(trace, name) for trace in fitted.model_.validate(runs, 0.5).traces])
        for name in ("measured", "forecast")
    )
    assert short.score(runs) == pytest.approx(sklearn.metrics.r2_score(measured, forecast), rel=1e-12)


# --------------------------------------------------------------------------- model selection
@pytest.mark.thorough
def test_grid_search_over_trajectories(runs):
    """A term that matters must not be thrown out, and cross-validation sees that."""
    search = GridSearchCV(la.SparseLagrangian(LIBRARY), {"relevance": [0.05], "degree": [4, 5]}, cv=KFold(2))
    search.fit(list(runs))
    assert search.best_score_ > 0.99
    assert {t.expression for t in search.best_estimator_.model_.terms} == {"theta_dot**2", "cos(theta)"}
    assert search.best_estimator_.model_.provenance["data"] == la.Trajectories(runs).digest()


@pytest.mark.thorough
def test_grid_search_chooses_the_library_that_forecasts_better():
    data = passive()
    q, t = [r.q for r in data], data[0].t
    poor = [text for text in CART["library"] if text != "x_dot*theta_dot*cos(theta)"]
    search = GridSearchCV(la.SparseLagrangian(**CART), {"library": [poor, CART["library"]]}, cv=3)
    search.fit(q, t=t)  # shared by all trajectories, so that score knows them too
    assert search.best_params_["library"] == CART["library"]
    low, high = search.cv_results_["mean_test_score"]
    assert low < high
    assert high > 0.99


@pytest.mark.thorough
def test_times_of_each_are_divided_with_the_trajectories():
    data = passive()
    q = [data[0].q, data[1].q[:500], data[2].q[:550]]
    t = [run.t[: len(x)] for run, x in zip(data, q, strict=True)]
    estimator = la.SparseLagrangian(**CART)
    scores = cross_val_score(estimator, q, t, cv=3)
    by_hand = [
        clone(estimator)
        .fit([q[i] for i in range(3) if i != k], [t[i] for i in range(3) if i != k])
        .score([q[k]], [t[k]])
        for k in range(3)
    ]
    np.testing.assert_allclose(scores, by_hand, rtol=1e-12)


def test_metadata_routing(runs):
    q, t = [r.q for r in runs], [r.t for r in runs]
    forces = [r.forces for r in runs]
    with sklearn.config_context(enable_metadata_routing=True):
        estimator = la.SparseLagrangian(LIBRARY, coordinates=["theta"])
        estimator.set_fit_request(t=True, forces=True).set_score_request(t=True, forces=True)
        search = GridSearchCV(estimator, {"degree": [5]}, cv=2).fit(q, t=t, forces=forces)
    plain = GridSearchCV(la.SparseLagrangian(LIBRARY), {"degree": [5]}, cv=2).fit(list(runs))
    assert search.best_score_ == pytest.approx(plain.best_score_, rel=1e-12)


# --------------------------------------------------------------------------------- misuse
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((np.zeros((30, 1)),), "t is missing; give the sampling interval"),
        ((np.zeros((30, 1)), 0.0), "t is 0.0; expected a positive sampling interval"),
        ((np.zeros((30, 1)), "t"), "t is 't'; expected a positive sampling interval"),
        ((np.zeros((30, 1)), np.arange(29)), "29"),
        (([np.zeros((30, 1))] * 2, [np.arange(30)] * 3), "t has 3 entries for 2 trajectories"),
        (([np.zeros((30, 1))] * 2, 0.1, [np.zeros((30, 1))]), "forces has 1 entries for 2 trajectories"),
        (([], 0.1), "q is empty"),
        ((np.zeros((30, 2)), 0.1), "q has 2 column"),
        ((np.zeros((30, 1), complex), 0.1), "Complex data not supported"),
        (([la.Trajectory(np.arange(30), np.zeros(30))], 0.1), "a Trajectory has its own times"),
        (([la.Trajectory(np.arange(30), np.zeros(30)), np.zeros(30)],), "item 1 is of type ndarray"),
    ],
)
def test_wrong_arguments(arguments, says):
    with pytest.raises(InputError, match=says):
        la.SparseLagrangian(LIBRARY, coordinates=["theta"]).fit(*arguments)


def test_too_little_data():
    with pytest.raises(DataError):
        la.SparseLagrangian(["q1_dot**2", "q1**2"], {"q1_dot**2": 0.5}).fit(np.arange(8.0)[:, None], 0.1)


def test_wrong_times_of_score(fitted):
    q = [np.zeros((30, 1))]
    with pytest.raises(InputError, match="t is missing"):
        fitted.score(q)
