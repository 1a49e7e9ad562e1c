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
    });
  }
}
