// Forms: one field per option or parameter, with its range, unit and help; what is wrong stands beside it.
"use strict";
const at = (id) => document.getElementById(id);

function make(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== false) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children);
  return node;
}

function range(field) {
  const low = field.low === null ? "" : `${field.low_open ? "more than" : "at least"} ${field.low}`;
  const high = field.high === null ? "" : `at most ${field.high}`;
  const text = [low, high].filter(Boolean).join(", ");
  return text && `${text[0].toUpperCase()}${text.slice(1)}.`;
}

function input(field, id) {
  if (field.kind === "flag") return make("input", { type: "checkbox", id, value: "true" });
  if (field.kind === "choice") {
    const first = make("option", { value: "" }, field.default ? `${field.default} (default)` : "–");
    const others = field.choices.filter((c) => c !== field.default).map((c) => make("option", { value: c }, c));
    return make("select", { id }, first, ...others);
  }
  const number = field.kind !== "text";
  const box = make("input", {
    id, placeholder: field.default || null, type: number ? "number" : "text", min: number ? field.low : null,
    max: number ? field.high : null, step: field.kind === "integer" ? "1" : number ? "any" : null,
    list: !number && field.choices.length ? `${id}-choices` : null, autocomplete: "off", spellcheck: "false",
  });
  return box;
}

function row(field, index) {
  const id = `field-${index}`;
  const box = input(field, id);
  box.name = field.name;
  const help_text = [field.help, range(field)].filter(Boolean).join(" ");
  const help = make("div", { class: "soft", id: `${id}-help` }, help_text);
  const wrong = make("div", { class: "wrong", id: `${id}-wrong`, role: "alert" });
  box.setAttribute("aria-describedby", `${id}-help ${id}-wrong`);
  if (field.kind === "flag") return make("div", { class: "field check" }, make("label", {}, box, field.title), help, wrong);
  const choices = field.kind === "text" && field.choices.length
    ? [make("datalist", { id: `${id}-choices` }, ...field.choices.map((c) => make("option", { value: c })))] : [];
  const line = make("span", {}, box, field.unit);
  return make("div", { class: "field" }, make("label", { for: id }, field.title), line, ...choices, help, wrong);
}

function build(form, action) {
  const rows = action.fields.map(row);
  const first = rows.filter((_, i) => !action.fields[i].more);
  const rest = rows.filter((_, i) => action.fields[i].more);
  const wrong = make("div", { class: "wrong", id: "field-all-wrong", role: "alert" });
  const start = make("button", { class: "main", id: "start" }, "Start");
  const more = rest.length ? [make("details", {}, make("summary", {}, "More options"), ...rest)] : [];
  form.replaceChildren(...first, ...more, wrong, start);
}

function filled(form) {
  const values = {};
  for (const box of form.querySelectorAll("input, select")) {
    const value = box.type === "checkbox" ? (box.checked ? "true" : "") : box.value.trim();
    if (box.validity.badInput) values[box.name] = "not a number";
    else if (value) values[box.name] = value;
  }
  return values;
}

function complain(form, problems) {
  const rest = { ...problems };
  for (const box of form.querySelectorAll("input, select")) {
    const text = rest[box.name] || "";
    at(`${box.id}-wrong`).textContent = text;
    box.setAttribute("aria-invalid", text ? "true" : "false");
    if (text && box.closest("details")) box.closest("details").open = true;
    delete rest[box.name];
  }
  at("field-all-wrong").textContent = Object.values(rest).join("; ");
  const first = form.querySelector("[aria-invalid=true]");
  if (first) first.focus();
}
