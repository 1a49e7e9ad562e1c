// A drawing of the arm that is repainted at most once in a display frame.

export class View {
  // Repaints also when the size of the stage or the colour scheme changes.
  repaintWith(stage) {
    new ResizeObserver(() => this.draw()).observe(stage);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  // Schedules a repaint by `paint` of the subclass.
  draw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = null;
      this.paint();
      this.painted?.(this.marks);
    });
  }

  // Whether the picture has each mark of the legend.
  get marks() {
    const { arm, bodies, state, editor } = this;
    const plan = editor.validPlan?.accepted ? editor.validPlan : null;
    const planned = plan?.waypoints.find((waypoint) => waypoint.body);
    return {
      measured: Boolean(bodies.known?.length),
      unknown: Boolean(bodies.unknown?.length),
      commanded: Boolean(bodies.commanded),
      ghost: Boolean(planned),
      deviation: Boolean(state?.tip && planned?.excursion),
      refused: editor.refused && editor.points.length > 0,
      goal: Boolean(state?.target),
      waypoints: this.waypoints.length > 1 || editor.points.length > 1,
      obstacle: this.obstacles.length > 0 || this.sketch !== null,
      density: Boolean(arm.density),
    };
  }
}
