// Delay of the device in lockstep, changed between two ticks. Forces in flight are kept.
const setDelay = (player, ticks) => {
  for (const d of player.devices) {
    const total = ticks + player.image.next_tick, whole = Math.floor(total), part = total - whole;
    const before = d.commands_count, count = whole + 2, kept = [];
    // Oldest last: the newest `count` − 1 forces of the ring, then the oldest again.
    for (let n = 1; n < count; n++) {
      kept.push(d.commands[(d.slot + before - Math.min(n, before - 1)) % before]);
    }
    d.commands.fill(0);
    d.slot = 0;
    d.commands_count = count;
    kept.forEach((force, n) => { d.commands[count - 1 - n] = force; });
    d.early = part * d.period;
    d.late = d.period - d.early;
    d.early_map.set(coefficients(d.mass, d.damping, d.grip, d.early));
    d.late_map.set(coefficients(d.mass, d.damping, d.grip, d.late));
    d.delay = ticks;
  }
  const { period } = player.driver;
  setLatency(player.driver, Number(((ticks * period) / period).toFixed(9)));
};

// Forces under way, for the energy account (nodes/driver/motion.py, `set_latency`).
const setLatency = (s, latency) => {
  const whole = Math.floor(latency), part = latency - whole;
  const length = latency ? whole + (part > 0.0 ? 2 : 1) : 0, before = s.line_length;
  const old = reals_at(s.lines, 3 * before).slice(), line = reals_at(s.lines_room, 3 * length);
  for (let i = 0; i < 3; i++) {
    for (let k = 0; k < length; k++) {
      line[i * length + k] = before ? old[i * before + Math.min(k, before - 1)] : s.acting[i];
    }
  }
  [s.lines, s.line_length, s.line_part] = [s.lines_room, length, latency ? part : 0.0];
};
