// Strokes in metres, y up. A stage is what World.draw works on: {context, description, snapshot, options, colors, scale,
// show, pixel}; scale: CSS pixels in a metre, pixel: metres in a CSS pixel.
const Brush = (() => {
  const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";
  const READABLE = 7; // pixels

  function circle({ context }, x, y, radius, color) {
    context.fillStyle = color;
    context.beginPath();
    context.arc(x, y, Math.max(0, radius), 0, 2 * Math.PI);
    context.fill();
  }

  function ring({ context }, x, y, radius) {
    context.beginPath();
    context.arc(x, y, Math.max(0, radius), 0, 2 * Math.PI);
    context.stroke();
  }

  function line({ context }, x, y, toX, toY) {
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(toX, toY);
    context.stroke();
  }

  function square({ context }, x, y, half, color) {
    context.fillStyle = color;
    context.fillRect(x - half, y - half, 2 * half, 2 * half);
  }

  // Words whose middle is at (x, y); left out where nobody could read them.
  function label({ context, scale }, words, x, y, height, color, weight = 600) {
    if (height * scale < READABLE) return;
    context.save();
    context.translate(x, y);
    context.scale(1 / scale, -1 / scale);
    context.font = `${weight} ${height * scale}px ${FONT}`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillStyle = color;
    context.fillText(words, 0, 0.04 * height * scale);
    context.restore();
  }

  // How an agent's side looks: {color, ink, box}.
  function side({ description }, i) {
    return description.sides[description.agents[i].side];
  }

  // An item's sign, on the ground or in a bag: heals have a cross, broken boxes are squares, others are plain discs.
  function glyph(stage, kind, owner, x, y, radius) {
    const { context, description, colors, pixel } = stage;
    const rim = Math.max(0.1 * radius, pixel);
    if (kind.role === "box_item") {
      square(stage, x, y, 0.85 * radius, colors.outline);
      square(stage, x, y, 0.85 * radius - rim, owner < 0 ? colors.box : description.sides[owner].box);
      square(stage, x, y, 0.3 * radius, colors.outline);
      return;
    }
    circle(stage, x, y, radius, colors.outline);
    circle(stage, x, y, radius - rim, kind.role === "heal" ? colors.heal : colors.box);
    if (kind.role !== "heal") return;
    context.strokeStyle = colors.white;
    context.lineWidth = 0.3 * radius;
    line(stage, x - 0.5 * radius, y, x + 0.5 * radius, y);
    line(stage, x, y - 0.5 * radius, x, y + 0.5 * radius);
  }

  return { circle, ring, line, square, label, side, glyph };
})();
