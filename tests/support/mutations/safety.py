"""Mutations of the driver's safety rules and of force admission; all must be noticed."""

from __future__ import annotations

from typing import Final

from tests.support.mutations.mutation import Mutation

ORACLES = "tests/nodes/driver/test_oracles.py"
NO_PUSH = "tests/nodes/driver/test_no_push.py"
SAFETY = "tests/nodes/driver/test_safety.py"
LIMITS = "tests/nodes/driver/test_force_limits.py"
SWINGS = "tests/nodes/driver/test_swings.py"
SHORT = "tests/nodes/driver/test_short_losses.py"
PASSIVE = "tests/nodes/driver/test_passivity.py"

DRIVER = "nodes/driver/"
SAFETY_RULES: Final = (
    Mutation(
        "half of the motor heat's reserve",
        f"{DRIVER}motor_heat.py",
        "(3.0 * s.slew)",
        "(6.0 * s.slew)",
        (ORACLES,),
    ),
    Mutation(
        "no heat while a force is held",
        f"{DRIVER}motor_heat.py",
        "s.watchdog)",
        "0)",
        (ORACLES, LIMITS),
    ),
    Mutation(
        "rearm keeps old swings",
        f"{DRIVER}safety.py",
        "s.peaks_count = s.peaked = 0",
        "s.peaked = 0",
        (NO_PUSH,),
    ),
    # Not here: `lost` drops what waited and is too old, but the clock before the write refuses that
    # as well.
    Mutation(
        "nor is it at its tick",
        f"{DRIVER}lateness.py",
        "(answers + s.max_age + 1)",
        "(answers + s.max_age + 3)",
        (ORACLES, NO_PUSH),
    ),
    Mutation(
        "a hold one tick long in a silence",
        f"{DRIVER}tick.py",
        "seq + 1 - s.written >=",
        "seq - s.written >=",
        (ORACLES,),
    ),
    Mutation(
        "a hold one tick short in a silence",
        f"{DRIVER}tick.py",
        "seq + 1 - s.written >=",
        "seq + 2 - s.written >=",
        (ORACLES,),
    ),
    Mutation(
        "a hold one tick long while held up",
        f"{DRIVER}lateness.py",
        "- (seq - s.written)",
        "- (seq - s.written) + 1",
        (ORACLES,),
    ),
    Mutation(
        "a hold one tick short while held up",
        f"{DRIVER}lateness.py",
        "- (seq - s.written)",
        "- (seq - s.written) - 1",
        (ORACLES,),
    ),
    Mutation(
        "the clock is not read before a write",
        f"{DRIVER}lateness.py",
        "return not is_late",
        "return True",
        (NO_PUSH,),
    ),
    Mutation(
        "a device that let go is not noticed before a write",
        f"{DRIVER}lateness.py",
        "is_late = held and now >=",
        "is_late = False and now >=",
        (NO_PUSH,),
    ),
    Mutation(
        "a delay one tick short",
        f"{DRIVER}tick.py",
        "s.delay = 1.0 + s.age",
        "s.delay = 0.0 + s.age",
        (ORACLES,),
    ),
    Mutation(
        "a delay without its age",
        f"{DRIVER}tick.py",
        "max(offset, after) + s.age",
        "max(offset, after)",
        (ORACLES,),
    ),
    Mutation(
        "a force that stays at its limit swings at every tick",
        f"{DRIVER}safety.py",
        "if side not in (0, s.sides[i]):",
        "if side != 0:",
        (NO_PUSH,),
    ),
    Mutation(
        "a force that stays at its limit does not count",
        f"{DRIVER}swings.py",
        "        s.pressed_at = seq\n        s.peaked = 1",
        "        s.pressed_at = seq",
        (NO_PUSH,),
    ),
    Mutation(
        "a hand that is let out again stops the driver",
        f"{DRIVER}swings.py",
        "and s.energy > s.pressed_energy:",
        "and s.energy > -1e9:",
        (NO_PUSH,),
    ),
    Mutation(
        "velocity of a late sample",
        f"{DRIVER}motion.py",
        "if s.virtual == 0:",
        "if s.virtual == 2:",
        (ORACLES,),
    ),
    Mutation(
        "a jump is a motion",
        f"{DRIVER}motion.py",
        "if stepped and s.jumped == 0 else",
        "if stepped else",
        (NO_PUSH,),
    ),
    Mutation(
        "a jump has no ramp",
        f"{DRIVER}safety.py",
        "s.ramp_ticks = s.recovery_ticks\n        s.regained = 0.0\n        s.fading = float",
        "_ = float",
        (NO_PUSH,),
    ),
    Mutation(
        "what is felt does not fade",
        f"{DRIVER}safety.py",
        "s.fading = max(s.fading - 1.0, 0.0)",
        "s.fading += 0.0",
        (NO_PUSH,),
    ),
    Mutation(
        "what was felt before a jump comes back after a gap",
        f"{DRIVER}safety.py",
        "s.begins, s.fading = 0, 0.0",
        "s.begins = 0",
        (NO_PUSH,),
    ),
    Mutation(
        "an answer of before the jump is played",
        f"{DRIVER}safety.py",
        "if s.got_seq < s.felt_seq:",
        "if s.got_seq < -1:",
        (NO_PUSH,),
    ),
    Mutation(
        "no ramp at the start",
        f"{DRIVER}safety.py",
        "s.ramp_ticks > 0 and (is_felt",
        "s.ramp_ticks < 0 and (is_felt",
        (NO_PUSH,),
    ),
    Mutation(
        "a ramp at every start",
        f"{DRIVER}safety.py",
        "(is_felt or s.always_ramp != 0)",
        "(is_felt or True)",
        (NO_PUSH,),
    ),
    Mutation(
        "a ramp grows twice as fast",
        f"{DRIVER}safety.py",
        "return max(min(2.0 - 2.0",
        "return 2.0 * max(min(2.0 - 2.0",
        (NO_PUSH, SAFETY),
    ),
    Mutation(
        "a gap costs four ticks of ramp",
        f"{DRIVER}safety.py",
        "REGAIN: Final = 5",
        "REGAIN: Final = 4",
        (NO_PUSH, SAFETY),
    ),
    Mutation(
        "a fault forgets no ramp",
        f"{DRIVER}safety.py",
        "    if state == FAULT:\n        s.regained = 0.0\n",
        "",
        (NO_PUSH, SAFETY),
    ),
    Mutation(
        "the slew of each force of a tick",
        f"{DRIVER}safety.py",
        "s.slewed[i] += abs",
        "s.slewed[i] = 0.0 * abs",
        (ORACLES,),
    ),
    Mutation(
        "the watchdog bites a tick late",
        f"{DRIVER}safety.py",
        "if silent < s.watchdog:",
        "if silent <= s.watchdog:",
        (SAFETY,),
    ),
    Mutation(
        "damping lasts a tick longer",
        f"{DRIVER}safety.py",
        "silent >= s.watchdog + s.damping",
        "silent > s.watchdog + s.damping",
        (SAFETY,),
    ),
    Mutation(
        "a force a tick older is taken",
        f"{DRIVER}safety.py",
        "seq - answers > s.max_age",
        "seq - answers > s.max_age + 1",
        (SAFETY,),
    ),
    Mutation(
        "a force is taken twice",
        f"{DRIVER}safety.py",
        "answers <= s.force_seq",
        "answers < s.force_seq",
        (SAFETY,),
    ),
    Mutation(
        "a stop needs no energy",
        f"{DRIVER}swings.py",
        "and gained > 0.0:",
        "and gained > -1e9:",
        (SWINGS,),
    ),
    Mutation(
        "the guard acts before the ramp",
        f"{DRIVER}safety.py",
        "s.safety in (ACTIVE, RAMP):\n        asked",
        "s.safety == ACTIVE:\n        asked",
        (PASSIVE, NO_PUSH),
    ),
    Mutation(
        "torn values of a pointer are taken",
        f"{DRIVER}pointer.py",
        "if after == before:",
        "if True:",
        ("tests/nodes/driver/test_pointer.py",),
    ),
    Mutation(
        "a window looks at one side",
        "nodes/laws/pd_windowed.py",
        "off > error or off < -error",
        "off > error",
        ("tests/nodes/laws/test_windowed_slope.py",),
    ),
    Mutation(
        "the mailbox plays what was decided before it let go",
        f"{DRIVER}hardware/mailbox.h",
        "is_old = m->silent &&",
        "is_old = 0 &&",
        (SHORT,),
    ),
    Mutation(
        "the mailbox lets the next force back at once",
        f"{DRIVER}hardware/mailbox.h",
        "if (is_old) m->owed = m->recovery;",
        "",
        (SHORT,),
    ),
)
