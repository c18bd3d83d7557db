// Elements, numbers and sentences that every page of this program uses.
export function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children.filter(child => child != null));
  return made;
}

export const button = (text, act, properties = {}) => element("button", { type: "button", textContent: text, onclick: act, ...properties });

export function field(label, input) {
  return element("label", {}, label, input);
}

export const number = (value, step = "any", properties = {}) => element("input", { type: "number", value, step, ...properties });

export function choice(options, value) {
  const made = element("select", {}, ...options.map(([key, words]) => element("option", { value: key, textContent: words })));
  if (value !== undefined) made.value = value;
  return made;
}

export function table(header, rows) {
  return element("div", { className: "wide" }, element("table", {},
    element("thead", {}, element("tr", {}, ...header.map(text => element("th", { textContent: text })))),
    element("tbody", {}, ...rows)));
}

// A sentence at the top of the page, until the next one or until it has been read.
let hiding = 0;
export function say(words, lasting = true) {
  const said = document.getElementById("said");
  said.textContent = words;
  said.hidden = !words;
  clearTimeout(hiding);
  if (!lasting) hiding = setTimeout(() => { said.hidden = true; }, 4000);
}

// Does what a button asks for, and says what went wrong.
export const act = what => async event => {
  const from = event?.currentTarget;
  try {
    if (from) from.disabled = true;
    say("");
    await what(event);
  } catch (error) {
    say(error.message);
  } finally {
    if (from) from.disabled = from.dataset.off === "true";
  }
};

export const clock = seconds => new Date(seconds * 1000).toLocaleString();
