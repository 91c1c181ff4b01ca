// Memory by address and the clock, for emitted rules (in Python: nodes/compiled/memory.py).
// An address is a byte offset into HEAP; 0 is no address. Integers stand in it as doubles.
const HEAP = new Float64Array(1 << 16);
let top_ = 8;
const placed = (values) => {
  const at = top_;
  if (at / 8 + values.length > HEAP.length) throw new RangeError("memory of the rules is full");
  HEAP.set(values, at / 8);
  top_ += 8 * values.length;
  return at;
};
const reals_at = (address, count) => HEAP.subarray(address / 8, address / 8 + count);
const wholes_at = reals_at;
const shared_real = (address) => HEAP[address / 8];
const shared_whole = shared_real;
const PAIRS = new Map();
const pairs_at = (address, count) => {
  let found = PAIRS.get(address);
  if (found === undefined || found.length !== count) {
    found = [];
    for (let i = 0; i < count; i++) found.push(reals_at(address + 16 * i, 2));
    PAIRS.set(address, found);
  }
  return found;
};
let now = 0.0; // time of the run [s]
const monotonic = () => now;
