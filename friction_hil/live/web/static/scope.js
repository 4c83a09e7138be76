// The scope: what the charts show, by a trigger as in an oscilloscope, and the motion that was kept for comparison.

const BEFORE = 0.25; // of the window, before the trigger
const DEAD = 0.05; // of the largest value: a smaller one has no direction

// Time of the last reversal in `times`, before which and after which `values` have opposite directions; null without one.
export function lastReversal(times, values, from) {
  const dead = DEAD * values.reduce((most, each) => Math.max(most, Math.abs(each ?? 0)), 0);
  let direction = 0;
  let found = null;
  values.forEach((value, k) => {
    if (value === null || Math.abs(value) <= dead) return;
    const now = Math.sign(value);
    if (direction && now !== direction && times[k] > from) found = times[k];
    direction = now;
  });
  return found;
}

export class Scope {
  kind = ""; // "reversal", "fault", or "" for charts that run on
  isSingle = false;
  shown = null; // time of the trigger whose motion is shown
  #faultAt = null;

  arm(kind, isSingle) {
    this.kind = kind;
    this.isSingle = isSingle;
    this.shown = null;
    this.#faultAt = null;
  }

  // A fault has come, at `time` of the last row.
  fault(time) {
    this.#faultAt ??= time;
  }

  // Look for a trigger in an axis's rows. Returns true once the motion after a new one is complete.
  look(times, velocity, windowS) {
    const end = times[times.length - 1];
    const after = (1 - BEFORE) * windowS;
    const isDue = (time) => time !== null && time > (this.shown ?? -Infinity) && time <= end - after;
    if (this.kind === "fault") {
      if (!isDue(this.#faultAt)) return false;
      this.shown = this.#faultAt;
      this.#faultAt = null;
      return true;
    }
    if (this.kind !== "reversal") return false;
    const last = times.findLastIndex((time) => time <= end - after) + 1;
    const from = Math.max(this.shown ?? -Infinity, times[0]);
    const found = lastReversal(times.slice(0, last), velocity.slice(0, last), from);
    if (!isDue(found)) return false;
    this.shown = found;
    return true;
  }

  // Range of time that the charts show.
  range(end, windowS) {
    if (!this.kind || this.shown === null) return [end - windowS, end];
    return [this.shown - BEFORE * windowS, this.shown + (1 - BEFORE) * windowS];
  }
}

// Values of kept rows at other times, which are `shift` s later; null outside of them.
export function resampled(kept, values, times, shift) {
  let k = 0;
  return times.map((time) => {
    const wanted = time - shift;
    while (k + 1 < kept.length && kept[k + 1] < wanted) k += 1;
    const [t0, t1, v0, v1] = [kept[k], kept[k + 1], values[k], values[k + 1]];
    if (!(t0 <= wanted && wanted <= t1) || v0 === null || v1 === null) return null;
    return t1 > t0 ? v0 + ((v1 - v0) * (wanted - t0)) / (t1 - t0) : v0;
  });
}
