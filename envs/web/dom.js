// Elements of both pages.
const Dom = (() => {
  const LONG = 4000; // milliseconds that a message stays
  let silence = 0;

  const $ = (id) => document.getElementById(id);

  // An element; text goes in as text, whatever it holds.
  function make(tag, name, parent, text) {
    const element = document.createElement(tag);
    if (tag === "button") element.type = "button";
    if (name) element.className = name;
    if (text !== undefined) element.textContent = text;
    if (parent) parent.append(element);
    return element;
  }

  function write(element, text) {
    if (element.textContent !== String(text)) element.textContent = text;
  }

  // Shows a message in #said for a while; an empty one takes the last away.
  function say(text) {
    clearTimeout(silence);
    write($("said"), text);
    $("said").hidden = !text;
    silence = setTimeout(() => { $("said").hidden = true; }, LONG);
  }

  const seconds = (ticks, description) => `${(ticks * description.seconds).toFixed(1)} s`;

  return { $, make, write, say, seconds };
})();
