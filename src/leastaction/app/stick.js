// Links, a cart with links, a point about an origin or in a plane, or blocks on a rail: measured behind, estimated
// dashed where there is no sensor, forecast in front; or a robot arm, measured, from one side or two. Colours come
// from the style sheet; motion.py and arm.py say what is drawn.
export default {
  template: `
    <figure>
      <div class="views">
        <div v-for="(name, view) in views">
          <svg :viewBox="box" role="img" :aria-label="words(name)">
            <path v-if="rail" class="rail" :d="rail" />
            <path :d="trail(view)" class="trail" />
            <template v-for="side in ['measured', 'forecast']">
              <g :class="side" v-if="shape(side, view)">
                <path v-if="shape(side, view).line" class="limbs" :d="shape(side, view).line" />
                <path v-if="shape(side, view).guess" class="limbs estimated" :d="shape(side, view).guess" />
                <rect v-for="p in shape(side, view).carts" :class="p[2]" :x="p[0] - 13" :y="p[1] - 8" width="26" height="16" rx="3" />
                <circle v-for="p in shape(side, view).joints" :class="p[2]" :cx="p[0]" :cy="p[1]" r="4.5" />
              </g>
            </template>
            <circle v-if="pivoted" class="pivot" cx="0" cy="0" r="3" />
          </svg>
          <p v-if="name" class="help">{{ name }}</p>
        </div>
      </div>
      <div class="controls">
        <button type="button" @click="toggle" class="play">{{ playing ? "Pause" : "Play" }}</button>
        <input type="range" min="0" :max="frames.t.length - 1" v-model.number="frame" @input="stop" aria-label="Time" />
        <output>{{ frames.t[frame].toFixed(2) }} s</output>
        <button type="button" @click="slower" class="pace" :aria-label="'Pace ' + paceText">{{ paceText }}</button>
      </div>
    </figure>`,
  props: { frames: Object },
  data() {
    return { frame: 0, playing: false, pace: 1, began: 0, handle: 0 };
  },
  computed: {
    box() {
      // What anything reaches, and the pivot.
      let [left, right, top, bottom] = [-30, 30, -12, 12];
      for (const rows of [this.frames.measured, this.frames.forecast]) {
        for (const row of rows) {
          for (const [x, y] of this.views.flatMap((_, view) => this.points(row, view) ?? [])) {
            left = Math.min(left, x);
            right = Math.max(right, x);
            top = Math.min(top, y);
            bottom = Math.max(bottom, y);
          }
        }
      }
      const room = this.sliding ? 18 : 8;
      return `${left - room} ${top - room} ${right - left + 2 * room} ${bottom - top + 2 * room}`;
    },
    arm() {
      return this.frames.kind === "arm";
    },
    views() {
      return this.frames.views ?? [""];
    },
    sliding() {
      return this.frames.kind === "cart" || this.frames.kind === "blocks";
    },
    pivoted() {
      return this.frames.kind === "links" || this.frames.kind === "polar" || this.arm;
    },
    rail() {
      return this.sliding ? "M-1000 10H1000" : "";
    },
    paceText() {
      return this.pace === 1 ? "1 ×" : "¼ ×";
    },
  },
  methods: {
    words(view) {
      if (this.arm) return `Robot arm as measured, ${view}`;
      const names = { links: "Links", cart: "Cart with links", plane: "Point in the plane", blocks: "Blocks" };
      const guess = this.frames.estimated.includes(true) ? ", estimated without a sensor dashed" : "";
      return `${names[this.frames.kind] ?? "Point about an origin"}: measured in grey${guess}, forecast in colour`;
    },
    trail(view) {
      // The last second of the end of the forecast, or of the arm.
      const [rows, parts] = [this.arm ? this.frames.measured : this.frames.forecast, []];
      for (let k = this.frame; k >= 0 && this.frames.t[this.frame] - this.frames.t[k] < 1; k--) {
        const p = this.points(rows[k], view);
        if (p) parts.push(p[p.length - 1].slice(0, 2).map((x) => x.toFixed(1)).join(" "));
      }
      return parts.length > 1 ? "M" + parts.join("L") : "";
    },
    points(row, view) {
      // Places, each with the entry of the row that it shows; a part whose entry is null is not known.
      if (!row) return null;
      const kind = this.frames.kind;
      if (this.arm) return Array.from({ length: row[view].length / 2 }, (_, k) => [row[view][2 * k], -row[view][2 * k + 1]]);
      if (kind === "plane" || kind === "polar")
        return row.includes(null) ? null : [[row[0], -row[1], this.frames.estimated.indexOf(true)]];
      if (kind === "blocks")
        return row.flatMap((x, k) => (x === null ? [] : [[x + 260 * (k - (row.length - 1) / 2), 0, k]]));
      const first = kind === "cart" ? 1 : 0;
      if (first && row[0] === null) return null;
      const points = [[first ? row[0] : 0, 0, 0]];
      for (let k = 0; k + first < row.length && row[k + first] !== null; k++) {
        const [[x, y], length, a] = [points[k], this.frames.lengths[k], row[k + first]];
        points.push([x + length * Math.sin(a), y + length * Math.cos(a), k + first]);
      }
      return points;
    },
    shape(side, view) {
      let points = this.points(this.frames[side][this.frame], view);
      if (!points) return null;
      const kind = this.frames.kind;
      const marks = side === "measured" ? (this.frames.estimated ?? []) : [];
      points = points.map(([x, y, entry]) => [x, y, marks[entry] ? "estimated" : ""]);
      let [limbs, carts, joints] = [[], [], points];
      if (this.arm) [limbs, joints] = [this.frames.limbs.map(([a, b]) => [points[a], points[b]]), points.slice(1)];
      // What hangs is held from the origin.
      else if (kind === "polar") limbs = this.frames.down ? [[[0, 0], points[0]]] : [];
      else if (kind === "blocks") [carts, joints] = [points, []];
      else if (kind !== "plane") {
        limbs = points.slice(1).map((p, k) => [points[k], p]);
        [carts, joints] = [kind === "cart" ? [points[0]] : [], points.slice(1)];
      }
      const line = (mark) =>
        limbs.map(([a, b]) => (b[2] === mark ? `M${a[0]} ${a[1]}L${b[0]} ${b[1]}` : "")).join("");
      return { line: line(""), guess: line("estimated"), carts, joints };
    },
    toggle() {
      if (this.playing) return this.stop();
      if (this.frame >= this.frames.t.length - 1) this.frame = 0;
      this.playing = true;
      this.began = performance.now() - (1000 * this.frames.t[this.frame]) / this.pace;
      this.handle = requestAnimationFrame(this.advance);
    },
    stop() {
      this.playing = false;
      cancelAnimationFrame(this.handle);
    },
    slower() {
      this.pace = this.pace === 1 ? 0.25 : 1;
      this.began = performance.now() - (1000 * this.frames.t[this.frame]) / this.pace;
    },
    advance(now) {
      if (!this.playing) return;
      const t = ((now - this.began) * this.pace) / 1000;
      const last = this.frames.t.length - 1;
      let k = this.frame;
      while (k < last && this.frames.t[k + 1] <= t) k++;
      this.frame = k;
      if (k >= last) {
        // A short stretch is seen better again and again.
        this.frame = 0;
        this.began = now + 600;
      }
      this.handle = requestAnimationFrame(this.advance);
    },
  },
  mounted() {
    if (!window.matchMedia("(prefers-reduced-motion: reduce)").matches) this.toggle();
  },
  unmounted() {
    this.stop();
  },
};
