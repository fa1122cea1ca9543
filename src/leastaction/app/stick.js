// Links of a plane pendulum: the measured ones behind, the forecast ones in front. Colours come from the style sheet.
export default {
  template: `
    <figure>
      <svg :viewBox="box" role="img" aria-label="Pendulum: measured in grey, forecast in colour">
        <path :d="trail" class="trail" />
        <g class="measured" v-if="links(frames.measured)">
          <polyline :points="links(frames.measured)" />
          <circle v-for="p in joints(frames.measured)" :cx="p[0]" :cy="p[1]" r="4.5" />
        </g>
        <g class="forecast" v-if="links(frames.forecast)">
          <polyline :points="links(frames.forecast)" />
          <circle v-for="p in joints(frames.forecast)" :cx="p[0]" :cy="p[1]" r="4.5" />
        </g>
        <circle class="pivot" cx="0" cy="0" r="3" />
      </svg>
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
      // What the ends of the links reach, and the pivot.
      let [left, right, top, bottom] = [-30, 30, -12, 12];
      for (const rows of [this.frames.measured, this.frames.forecast]) {
        for (const row of rows) {
          for (const [x, y] of row ? this.points(row) : []) {
            left = Math.min(left, x);
            right = Math.max(right, x);
            top = Math.min(top, y);
            bottom = Math.max(bottom, y);
          }
        }
      }
      return `${left - 8} ${top - 8} ${right - left + 16} ${bottom - top + 16}`;
    },
    paceText() {
      return this.pace === 1 ? "1 ×" : "¼ ×";
    },
    trail() {
      // The last second of the forecast's end.
      const parts = [];
      for (let k = this.frame; k >= 0 && this.frames.t[this.frame] - this.frames.t[k] < 1; k--) {
        const p = this.points(this.frames.forecast[k]);
        if (p) parts.push(p[p.length - 1].map((x) => x.toFixed(1)).join(" "));
      }
      return parts.length > 1 ? "M" + parts.join("L") : "";
    },
  },
  methods: {
    points(angles) {
      if (!angles) return null;
      const length = 98 / angles.length;
      const points = [[0, 0]];
      for (const a of angles) {
        const [x, y] = points[points.length - 1];
        points.push([x + length * Math.sin(a), y + length * Math.cos(a)]);
      }
      return points;
    },
    links(rows) {
      const p = this.points(rows[this.frame]);
      return p && p.map((x) => x.join(",")).join(" ");
    },
    joints(rows) {
      return this.points(rows[this.frame]).slice(1);
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
