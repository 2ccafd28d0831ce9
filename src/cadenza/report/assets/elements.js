// Elements of a page.

const $ = (id) => document.getElementById(id);

/** Makes an element of a text or of parts, with properties, and with attributes where they are none. */
function make(name, content = [], properties = {}) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(properties)) {
    if (key === "role" || key.includes("-")) element.setAttribute(key, value); else element[key] = value;
  }
  element.append(...[content].flat());
  return element;
}
