/* What a test asks of a page: text too faint on its background (WCAG 2), and text that is cut off at the side. */
(() => {
const shown = [...document.querySelectorAll("body *")].filter(
  (e) => e.getClientRects().length && !e.closest("svg, script, style"));
const words = (e) => `${e.tagName} ${e.className}: ${e.textContent.trim().slice(0, 40)}`;

function parts(colour) {
  const n = colour.match(/[\d.]+/g).map(Number);
  return { rgb: n.slice(0, 3), opacity: n[3] === undefined ? 1 : n[3] };
}
const over = (top, below) => top.rgb.map((v, k) => top.opacity * v + (1 - top.opacity) * below[k]);
function behind(e) {
  const below = e.parentElement ? behind(e.parentElement) : [255, 255, 255];
  return over(parts(getComputedStyle(e).backgroundColor), below);
}
function luminance(rgb) {
  const linear = rgb.map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
  return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
}
function contrast(e) {
  const back = behind(e), pair = [luminance(over(parts(getComputedStyle(e).color), back)), luminance(back)];
  return (Math.max(...pair) + 0.05) / (Math.min(...pair) + 0.05);
}

const scrolls = (e) => e && (["auto", "scroll"].includes(getComputedStyle(e).overflowX) || scrolls(e.parentElement));
function cut(e) {
  const box = e.getBoundingClientRect(), wide = document.documentElement.clientWidth;
  return !scrolls(e) && (box.right > wide + 1 || box.left < -1);
}

const texts = shown.filter((e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()));
return {
  texts: texts.length,
  faint: texts.filter((e) => contrast(e) < 4.5).map((e) => `${contrast(e).toFixed(2)} ${words(e)}`),
  cut: shown.filter(cut).map(words),
};
})()
