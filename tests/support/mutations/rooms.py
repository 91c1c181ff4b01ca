"""Mutations in laws, verdicts, recordings and identification that earlier tests missed."""

from __future__ import annotations

from typing import Final

from tests.support.mutations.mutation import Mutation

RECORDED = "tests/nodes/recording/test_recorded_figures.py"
TABLES = "tests/nodes/recording/test_export.py"
K_MAX = "tests/nodes/stability/test_k_max.py"
STABILITY = "tests/nodes/stability/test_stability.py"
JUDGE = "tests/nodes/stability/test_judge.py"
EASING = "tests/nodes/coupling/test_easing.py"
COUPLING = "tests/nodes/coupling/test_coupling.py"
YIELDING = "tests/nodes/coupling/test_yielding.py"
CURVED = "tests/nodes/coupling/test_curved.py"
LAWS = "tests/nodes/laws/test_laws.py"
GAINS = "tests/nodes/laws/test_gains.py"
FITS = "tests/sim/identify/test_judge.py"
IDENTIFY = "tests/sim/identify/test_identify.py"
ORACLES = "tests/nodes/driver/test_oracles.py"
PASSIVE = "tests/nodes/driver/test_passivity.py"
REMAINDER = "tests/sim/identify/test_remainder.py"

NAMED_RULES: Final = (
    Mutation(
        "the row that leaves the window loses its answer",
        "nodes/recording/table.py",
        "yield take(waiting[0], waiting[1])",
        "yield take(waiting[0], None)",
        (TABLES,),
    ),
    Mutation(
        "an answer of a later tick counts for a gap",
        "nodes/recording/table.py",
        "following.seq == state.seq + 1",
        "following.seq > state.seq",
        (TABLES,),
    ),
    Mutation(
        "what waits for answers is not forgotten at a restart",
        "nodes/recording/table.py",
        "                waiting.clear()\n"
        "                proxies.clear()\n"
        "                forces.clear()\n",
        "                waiting.clear()\n",
        (TABLES,),
    ),
    Mutation(
        "a missed tick has a response of 0 µs",
        "nodes/recording/summary.py",
        "if last.response > 0.0:",
        "if last.response >= 0.0:",
        (RECORDED,),
    ),
    Mutation(
        "the last age is the oldest one",
        "nodes/recording/summary.py",
        "oldest = max(oldest, last.age)",
        "oldest = last.age",
        (RECORDED,),
    ),
    Mutation(
        "what a driver missed before it was started again is taken back",
        "nodes/recording/summary.py",
        "missed += max(last.missed - before.missed, 0)",
        "missed = last.missed",
        (RECORDED,),
    ),
    Mutation(
        "of a node's processes only the last one sent anything",
        "nodes/recording/accounts.py",
        "sent = sum(node.sent.values())",
        "sent = [*node.sent.values()][-1]",
        (RECORDED,),
    ),
    Mutation(
        "a loop without a spring may grow by e in two seconds",
        "nodes/stability/judge.py",
        "MARGINAL = 1e-6",
        "MARGINAL = 1e-3",
        (JUDGE,),
    ),
    Mutation(
        "an anchored device is judged as a free one",
        "nodes/stability/judge.py",
        "(springless or law.h1 == 0.0) and not plant.anchored",
        "springless or law.h1 == 0.0",
        (JUDGE,),
    ),
    Mutation(
        "of several stable intervals the first is not the only one that counts",
        "nodes/stability/k_max.py",
        "top = stable[0][1]",
        "top = stable[-1][1] + 1.0",
        (K_MAX, STABILITY),
    ),
    Mutation(
        "a sum of taps that is rounding is a stiffness",
        "nodes/laws/parse.py",
        "or compiled.h1 > _rounding(compiled)",
        "or compiled.h1 > 0.0",
        (LAWS, GAINS),
    ),
    Mutation(
        "a section that grows is rendered",
        "nodes/laws/parse.py",
        "if not compiled.stable_sections():",
        "if False:",
        (LAWS, GAINS),
    ),
    Mutation(
        "an edge turns the history",
        "nodes/coupling/render.py",
        "LEAST_COSINE: Final = 0.9",
        "LEAST_COSINE: Final = -0.9",
        (CURVED,),
    ),
    Mutation(
        "what yields is not taken from the history",
        "nodes/coupling/render.py",
        "        history[head] -= by\n        history[head + s.length] -= by\n",
        "        history[head] -= by\n",
        (YIELDING,),
    ),
    Mutation(
        "an easing begins at what the law asked for, not at what was felt",
        "nodes/coupling/render.py",
        "s.ease_from[i] = limit(s.felt[i], 0.0, peak, math.inf)",
        "s.ease_from[i] = asked",
        (EASING,),
    ),
    Mutation(
        "an easing is of the force without its limit",
        "nodes/coupling/render.py",
        "asked = limit(force[i], 0.0, peak, math.inf)",
        "asked = force[i]",
        (EASING,),
    ),
    Mutation(
        "a fade lasts a tick longer",
        "nodes/coupling/render.py",
        "if s.fade_done >= s.fade_ramp:",
        "if s.fade_done > s.fade_ramp:",
        (COUPLING, "tests/nodes/coupling/test_law_book.py"),
    ),
    Mutation(
        "a gap is bridged by its last value",
        "nodes/coupling/render.py",
        "before + (newest - before) * k / (missing + 1)",
        "newest",
        (COUPLING, CURVED),
    ),
    Mutation(
        "whiteness refutes nothing",
        "sim/identify/judge_fit.py",
        "IMPROBABLE = 1e-4",
        "IMPROBABLE = 0.0",
        ("tests/sim/identify/test_whiteness.py",),
    ),
    Mutation(
        "the windows' own states cost no degrees of freedom",
        "sim/identify/judge_fit.py",
        "int((~unread).sum()) - own * len(residual) - unknowns.shape[1]",
        "int((~unread).sum())",
        ("tests/sim/identify/test_left.py",),
    ),
    Mutation(
        "models that hold are drawn without noise",
        "sim/identify/judge_fit.py",
        "if noise > 0.1 * size:",
        "if noise > 1e9 * size:",
        (FITS,),
    ),
    Mutation(
        "an interval of 95 % is one of 68 %",
        "sim/identify/conclude.py",
        "CONFIDENCE = 0.95",
        "CONFIDENCE = 0.68",
        ("tests/sim/identify/test_left.py",),
    ),
    Mutation(
        "an interval has a negative width",
        "sim/identify/conclude.py",
        "0.5 + 0.5 * CONFIDENCE",
        "0.5 * CONFIDENCE",
        ("tests/sim/identify/test_half_widths.py",),
    ),
    Mutation(
        "windows that differ are as sure as those that agree",
        "sim/identify/conclude.py",
        "between = inverse @ (scores.T @ scores) @ inverse * (windows - 1) / windows",
        "between = 0.0 * inverse",
        (IDENTIFY, FITS, REMAINDER),
    ),
    Mutation(
        "a guard along one axis reads the forces under way of another",
        "nodes/driver/passivity.py",
        "            reals_at(s.lines + 8 * i * s.line_length, s.line_length), s.line_part\n"
        "        )\n"
        "    expected += (share",
        "            reals_at(s.lines, s.line_length), s.line_part\n"
        "        )\n"
        "    expected += (share",
        (PASSIVE,),
    ),
    Mutation(
        "a guard in space takes y for z",
        "nodes/driver/passivity.py",
        "else y if i == 1 else z)",
        "else y if i != 1 else z)",
        (PASSIVE,),
    ),
    Mutation(
        "an answer that came too late to be played is not counted",
        "nodes/driver/tick.py",
        "            s.skipped += 1\n            if s.arrival",
        "            if s.arrival",
        (ORACLES,),
    ),
    Mutation(
        "an answer of another tick is not counted in lockstep",
        "nodes/driver/tick.py",
        "            s.skipped += 1\n        s.response",
        "        s.response",
        (ORACLES,),
    ),
    Mutation(
        "a rate is ticks times seconds",
        "nodes/driver/run_report.py",
        "(s.asked - self.first_seq) / span",
        "(s.asked - self.first_seq) * span",
        (ORACLES,),
    ),
    Mutation(
        "a loop's polynomial keeps a root at 0",
        "nodes/stability/closed_loop.py",
        "if numerator.any() else numerator",
        "if not numerator.any() else numerator",
        (STABILITY,),
    ),
    Mutation(
        "a figure's frame is in half millimetres",
        "nodes/recording/plot_panels.py",
        "position = lines.position.arrays()[1][:, axis] * 1e3",
        "position = lines.position.arrays()[1][:, axis] * 2e3",
        ("tests/nodes/recording/test_plot.py",),
    ),
    Mutation(
        "a recording in lockstep is one in real time",
        "sim/identify/recorded_scene.py",
        'lockstep = launch.run.pace == "lockstep"',
        'lockstep = launch.run.pace != "lockstep"',
        ("tests/sim/identify/test_counterfactual.py",),
    ),
    Mutation(
        "a mass in a gap begins at the end that it will reach",
        "sim/identify/suspects.py",
        "y = 0.5 * gap * np.sign(v[:, 0])",
        "y = 0.5 * gap * np.sign(v[:, 1])",
        (FITS,),
    ),
)
