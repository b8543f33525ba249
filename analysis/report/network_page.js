// Runs when the view changes. `near` holds what is drawn only from near: the marker or text, the
// widest view, m, in which it is drawn, and its size there and elsewhere. A marker of size 0 is not
// drawn, but its sample in the legend is; and `visible` is left to the legend.
const range = plot.x_range;
const width = range.end - range.start;
for (const [drawn, limit, size, small] of near) {
  const close = width <= limit;
  if (drawn.glyph.type === "Text") {
    drawn.glyph.setv({
      text_alpha: { value: close ? 1 : 0 },
      background_fill_alpha: { value: close ? 0.7 : 0 },
    });
  } else {
    drawn.glyph.setv({ size: { value: close ? size : small } });
  }
}
// On a phone names stand in short rows, and a finger moves the page.
if (document.body.clientWidth < 600) {
  for (const part of plot.above) if (part.type === "Legend" && part.ncols > 3) part.ncols = 3;
}
if (matchMedia("(pointer: coarse)").matches && plot.toolbar.active_drag) plot.toolbar.active_drag = null;
