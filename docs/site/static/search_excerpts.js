"use strict";
// Sphinx fetches each page for its excerpt, which a browser refuses for files; here the texts are at hand.
const WORDS_AROUND = 160;

// The search splits words at such marks, and finds no letter alone.
const SHORTENED = { "s/n": "signal-to-noise" };
const speltOut = (query) => SHORTENED[query.trim().toLowerCase()] || query;

// The whole query first, then each of its words.
const searched = () => {
  const query = speltOut(new URLSearchParams(window.location.search).get("q") || "").toLowerCase();
  return [query, ...query.split(/[^\p{L}\p{N}_]+/u)].filter(Boolean);
};

const pageOf = (link) => link.getAttribute("href").split("#")[0].replace(/\.html$/, "");

// K22 may stand in a range, K11 .. K66: then the first name of that kind.
function placeOf(text, word) {
  const place = text.indexOf(word);
  const head = place < 0 && /^(\p{L}+)\d+$/u.exec(word);
  return head ? text.search(new RegExp(`(?<![\\p{L}\\d])${head[1]}\\d`, "u")) : place;
}

function excerpt(text, words) {
  const low = text.toLowerCase();
  const at = words.map((word) => placeOf(low, word)).find((place) => place >= 0) ?? 0;
  const start = Math.max(at - WORDS_AROUND / 2, 0);
  const end = Math.min(start + 2 * WORDS_AROUND, text.length);
  const before = start > 0 ? "… " : "";
  const after = end < text.length ? " …" : "";
  const part = text.slice(start, end);
  return before + part.slice(start > 0 ? part.indexOf(" ") + 1 : 0, after ? part.lastIndexOf(" ") : undefined) + after;
}

function addExcerpt(item) {
  const link = item.querySelector("a");
  const text = link && PAGE_TEXTS[pageOf(link)];
  if (!text || item.querySelector("p.excerpt")) return;
  const shown = document.createElement("p");
  shown.className = "excerpt";
  shown.textContent = excerpt(text, searched());
  item.appendChild(shown);
}

document.addEventListener("DOMContentLoaded", () => {
  const perform = Search.performSearch; // before it is called: this script comes first
  Search.performSearch = (query) => perform(speltOut(query));
  const results = document.getElementById("search-results");
  if (!results) return;
  new MutationObserver(() => results.querySelectorAll("ul.search > li").forEach(addExcerpt)).observe(results, {
    childList: true,
    subtree: true,
  });
});
