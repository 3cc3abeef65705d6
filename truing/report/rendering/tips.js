// Shows the sentence of a head, a name or a term: when it is pointed at, tapped, or reached by the keyboard.
"use strict";
(() => {
  const EXPLAINED = "a.defined, abbr[tabindex]";
  const WAIT = 250; // ms of pointing, so that a pointer on its way opens nothing
  const GAP = 4; // px
  const tip = Object.assign(document.createElement("span"), { className: "tip", hidden: true });
  const words = Object.assign(document.createElement("span"), { id: "tip" });
  const more = Object.assign(document.createElement("a"), { textContent: "Reference" });
  tip.append(words, more);
  let shown = null;
  let waiting = 0;
  let touched = false; // whether the last pointer was a finger

  // The browser's own tooltip would stand over this one, and no finger opens it.
  for (const one of document.querySelectorAll(EXPLAINED)) {
    one.dataset.tip = one.title;
    one.removeAttribute("title");
    if (one.closest("thead")) one.setAttribute("role", "button"); // a click sorts; the tip has the link
  }

  const place = (one) => {
    const box = one.getBoundingClientRect();
    const wide = document.documentElement.clientWidth;
    tip.style.left = `${Math.max(GAP, Math.min(box.left, wide - tip.offsetWidth - GAP)) + scrollX}px`;
    const below = box.bottom + GAP + tip.offsetHeight < innerHeight || box.top < tip.offsetHeight;
    tip.style.top = `${(below ? box.bottom + GAP : box.top - tip.offsetHeight - GAP) + scrollY}px`;
  };

  const show = (one) => {
    clearTimeout(waiting);
    if (shown === one) return;
    hide();
    shown = one;
    words.textContent = one.dataset.tip;
    more.hidden = !one.hash;
    if (one.hash) more.href = one.hash;
    one.setAttribute("aria-describedby", "tip");
    one.after(tip); // the next stop of the Tab key is its link
    tip.hidden = false;
    place(one);
  };

  const hide = () => {
    clearTimeout(waiting);
    shown?.removeAttribute("aria-describedby");
    shown = null;
    tip.hidden = true;
    tip.remove(); // so that cells keep their own words
  };

  const over = (target) => (target instanceof Element ? target.closest(EXPLAINED) : null);
  const inTip = (target) => target instanceof Node && tip.contains(target);

  document.addEventListener("pointerover", ({ target, pointerType }) => {
    if (pointerType === "touch" || inTip(target)) return clearTimeout(waiting);
    const one = over(target);
    clearTimeout(waiting);
    if (one) waiting = setTimeout(show, WAIT, one);
    else if (shown && shown !== document.activeElement) waiting = setTimeout(hide, WAIT);
  });
  document.addEventListener("pointerdown", ({ target, pointerType }) => {
    touched = pointerType === "touch";
    if (shown && !inTip(target) && over(target) !== shown) hide();
  });
  document.addEventListener("focusin", ({ target }) => {
    if (over(target)?.matches(":focus-visible")) show(over(target));
  });
  document.addEventListener("focusout", ({ relatedTarget }) => {
    if (shown && !inTip(relatedTarget) && relatedTarget !== shown) hide();
  });
  document.addEventListener("keydown", ({ key }) => key === "Escape" && hide());
  // The first tap explains; the link of the tip leads on. A click on a head sorts.
  document.addEventListener("click", (event) => {
    if (inTip(event.target)) return event.target === more && setTimeout(hide);
    const one = over(event.target);
    if (!one) return;
    const sorts = Boolean(one.closest("thead"));
    if (touched) show(one);
    else if (!sorts) hide();
    if (touched || sorts || one.closest("summary") && !one.hash) event.preventDefault();
  });
  window.addEventListener("beforeprint", hide);
  window.addEventListener("resize", hide);
})();
