// Viewport: the canvas of the world, its camera, and the colour theme.
const Viewport = (() => {
  const CLOSE = 7; // metres from the middle to the edge of a close-up
  const EASE = 7; // per second: how fast the camera approaches its goal

  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const still = window.matchMedia("(prefers-reduced-motion: reduce)");
  const theme = () => COLORS[dark.matches ? "dark" : "light"];

  function applyTheme() {
    for (const [name, color] of Object.entries(theme())) document.documentElement.style.setProperty(`--${name}`, color);
  }

  // onTheme() is called when the colours change. Returns {draw, agentAt}.
  function build(canvas, onTheme) {
    const context = canvas.getContext("2d");
    let camera = null, before = 0;
    applyTheme();
    dark.addEventListener("change", () => { applyTheme(); onTheme(); });

    // Paints; view: {show, follow, trails, marks, close}. Returns whether the camera is still moving.
    function draw(description, snapshot, view) {
      const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
      const [wide, high] = [Math.round(width * ratio), Math.round(height * ratio)];
      if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
      const moving = move(aim(description, snapshot, view));
      World.draw(context, description, snapshot, { ...view, width, height, ratio, camera, colors: theme() });
      canvas.dataset.tick = snapshot.tick;
      return moving;
    }

    function aim({ half }, { agents }, { follow, close }) {
      const agent = agents[follow];
      return agent && close && half > CLOSE ? { x: agent.x, y: agent.y, half: CLOSE } : { x: 0, y: 0, half };
    }

    function move(goal) {
      const now = performance.now(), share = 1 - Math.exp(-EASE * Math.min(0.1, (now - before) / 1000));
      before = now;
      if (!camera || still.matches) camera = goal;
      const far = Math.abs(goal.x - camera.x) + Math.abs(goal.y - camera.y) + Math.abs(goal.half - camera.half);
      if (far < 0.005) camera = goal;
      else for (const key of ["x", "y", "half"]) camera[key] += share * (goal[key] - camera[key]);
      camera = { ...camera };
      return far >= 0.005;
    }

    // The living agent at a point of the window, -1: none.
    function agentAt(description, snapshot, clientX, clientY) {
      const box = canvas.getBoundingClientRect(), scale = Math.min(box.width, box.height) / (2 * camera.half);
      const x = camera.x + (clientX - box.left - box.width / 2) / scale;
      const y = camera.y - (clientY - box.top - box.height / 2) / scale;
      return snapshot.agents.findIndex((agent, i) =>
        agent.alive && Math.hypot(agent.x - x, agent.y - y) < Math.max(1.5 * description.agents[i].radius, 12 / scale));
    }

    return { draw, agentAt };
  }

  return { build, theme, applyTheme, still: () => still.matches };
})();
