// Strokes in metres, y up. A scene is what World.draw works on: {context, description, snapshot, options, colors, scale,
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

  function cross(scene, x, y, arm) {
    line(scene, x - arm, y - arm, x + arm, y + arm);
    line(scene, x - arm, y + arm, x + arm, y - arm);
  }

  function square({ context }, x, y, half, color) {
    context.fillStyle = color;
    context.fillRect(x - half, y - half, 2 * half, 2 * half);
  }

  // Adds a closed polygon to a path; corners: [ahead, left] of a body {x, y, angle}, times `unit` metres.
  function outline(path, corners, { x, y, angle }, unit = 1) {
    const cosine = unit * Math.cos(angle), sine = unit * Math.sin(angle);
    corners.forEach(([a, b], k) => path[k ? "lineTo" : "moveTo"](x + a * cosine - b * sine, y + a * sine + b * cosine));
    path.closePath();
  }

  // The corners of a rectangle or polygon, [ahead, left], metres, counter-clockwise.
  function cornersOf({ corners, width, height }) {
    return corners?.length ? corners : [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) => [a * width / 2, b * height / 2]);
  }

  // Words whose middle is at (x, y); left out where they would be unreadable.
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

  // The colour of a box, or of the item that it became.
  const boxColor = ({ description, colors }, owner) => (owner < 0 ? colors.box : description.sides[owner].box);

  // An item, on the ground or in a bag: heals have a cross, broken boxes are squares, others are plain discs of their kind's colour.
  function item(scene, kind, owner, x, y, radius) {
    const { context, colors, pixel } = scene;
    const rim = Math.max(radius / 10, pixel);
    if (kind.role === "box_item") {
      const half = SIZES.box_item * radius;
      square(scene, x, y, half, colors.outline);
      square(scene, x, y, half - rim, boxColor(scene, owner));
      square(scene, x, y, half / 3, colors.outline);
      return;
    }
    circle(scene, x, y, radius, colors.outline);
    circle(scene, x, y, radius - rim, kind.role === "heal" ? colors.heal : kind.color || colors.box);
    if (kind.role !== "heal") return;
    const arm = SIZES.cross * radius;
    context.strokeStyle = colors.white;
    context.lineWidth = SIZES.cross_width * radius;
    line(scene, x - arm, y, x + arm, y);
    line(scene, x, y - arm, x, y + arm);
  }

  return { FONT, circle, ring, line, cross, square, outline, cornersOf, label, side, boxColor, item };
})();
