// Draws figures when they come near the view, and all of them, at the width of the paper, before the page is printed.
"use strict";
(() => {
  // px that A4 leaves between its margins, and less than its height; a figure of half a page leaves no page half empty,
  // if its letters stay large enough.
  const PAPER = { width: 680, height: 820, half: 350, least: 0.62 };
  const PRINT_OF_TABLES = 8 / 10.5; // their letters on paper over those on the screen
  const config = {
    displaylogo: false,
    responsive: true,
    showSendToCloud: false, // nothing of a campaign may leave the page
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  };
  const read = (element) => JSON.parse(element.textContent);
  const plots = [...document.querySelectorAll(".plot")];
  const held = (plot) => plot.closest("figure").querySelector("script.figure-data");
  const drawn = new Map(); // plot -> promise of its drawing

  // The library waits as text, so that the words of the page are there before it is read.
  const library = () => {
    if (!window.Plotly) {
      const script = document.createElement("script");
      script.textContent = document.getElementById("plotly").textContent;
      document.head.append(script);
    }
    return window.Plotly;
  };

  // A figure as it is to be drawn at a width: what a reader has chosen of it, and on a phone for a phone.
  const laidOut = (plot, width) => {
    const { data, layout, steps, scene } = read(held(plot));
    layout.template ??= read(document.getElementById("template"));
    if (scene) Object.assign(layout.scene, window.Scene.into(data, scene, chosenIn(plot)));
    window.Narrow.into(data, layout, width);
    const chosen = chooser(plot);
    const restyled = !scene && chosen?.value > 0 ? steps[chosen.value].args : null;
    return { data, layout, restyled };
  };

  const isNarrow = (width) => width < window.Narrow.WIDEST;

  const put = (plot, width) => {
    const { data, layout, restyled } = laidOut(plot, width);
    const camera = plot.layout?.scene?.camera; // where the reader has turned it
    if (camera) layout.scene.camera = camera;
    const narrow = `${isNarrow(width)}`;
    // Drawn over one that was laid out for another width, plotly starts from that one's margins, and fails.
    const how = plot.dataset.narrow === narrow ? "react" : "newPlot";
    if (how === "newPlot" && drawn.has(plot)) library().purge(plot);
    plot.style.height = `${layout.height}px`;
    plot.dataset.narrow = narrow;
    const done = library()[how](plot, data, layout, config);
    if (restyled) library().update(plot, ...restyled);
    return done.then(() => name(plot));
  };

  const draw = (plot) => {
    if (!drawn.has(plot)) drawn.set(plot, put(plot, plot.clientWidth));
    return drawn.get(plot);
  };

  const redraw = (plot, width = plot.clientWidth) => {
    if (drawn.has(plot)) drawn.set(plot, put(plot, width));
  };

  // A picture has nothing inside that is operated: it is the drawing, and its buttons stand beside it.
  const name = (plot) => {
    const [picture, ...others] = plot.querySelectorAll(".main-svg");
    picture.setAttribute("role", "img");
    plot.dataset.spoken ??= plot.getAttribute("aria-label");
    picture.setAttribute("aria-label", plot.dataset.spoken);
    others.forEach((other) => other.setAttribute("aria-hidden", "true"));
    plot.setAttribute("role", "group");
    plot.setAttribute("aria-label", "figure and its buttons");
  };

  const chooser = (plot) => plot.closest("figure").querySelector(".steps input");

  const told = (input, label) => {
    input.setAttribute("aria-valuetext", label);
    input.closest(".steps").querySelector("output").textContent = label;
  };

  const choose = (plot) => {
    const input = chooser(plot);
    const { steps, scene } = read(held(plot));
    if (scene) return chooseIn(plot, steps, scene);
    const show = () => {
      const { label, args } = steps[input.value];
      told(input, label);
      if (drawn.has(plot)) library().update(plot, ...args);
    };
    input.addEventListener("input", show);
    show(); // a page that is loaded again may keep where the slider stood
  };

  // What a reader has chosen of a 3-D view: step, amplification, legs.
  const controls = (plot) => [...plot.closest("figure").querySelectorAll("input")];
  const chosenIn = (plot) => {
    const inputs = controls(plot);
    const value = (kind) => +inputs.find((input) => input.classList.contains(kind)).value;
    const legs = inputs.filter((input) => input.type === "checkbox" && input.checked).map((input) => +input.value);
    return { step: value("step"), gain: value("gain"), legs };
  };

  const chooseIn = (plot, steps, scene) => {
    const figure = plot.closest("figure");
    const show = () => {
      const chosen = chosenIn(plot);
      told(figure.querySelector(".step"), steps[chosen.step]);
      told(figure.querySelector(".gain"), window.Scene.scale(scene, chosen));
      window.Scene.tell(figure, scene, chosen);
      redraw(plot);
    };
    controls(plot).forEach((input) => input.addEventListener("input", show));
    show();
  };

  // What is too large for the paper is made smaller, not cut.
  const fit = (table) => {
    const area = table.parentElement;
    area.style.width = `${PAPER.width / PRINT_OF_TABLES}px`;
    const share = PAPER.width / PRINT_OF_TABLES / table.offsetWidth;
    area.style.width = "";
    table.style.setProperty("--fit", Math.min(1, share));
  };

  const toPaper = () => {
    document.querySelectorAll("table").forEach(fit);
    for (const plot of plots) {
      if (!plot.clientWidth) continue; // folded: not on paper
      if (!drawn.has(plot)) draw(plot);
      if (plot.dataset.narrow === "true") redraw(plot, PAPER.width);
      plot.dataset.height = plot.layout.height;
      const half = Math.max(PAPER.least, PAPER.half / plot.dataset.height);
      const share = Math.min(1, half, PAPER.height / plot.dataset.height);
      plot.style.setProperty("--fit", share);
      library().relayout(plot, { width: PAPER.width / share, height: +plot.dataset.height });
    }
  };

  const toScreen = () => {
    for (const plot of plots) {
      if (!plot.clientWidth || !drawn.has(plot)) continue;
      library().relayout(plot, { width: null, height: +plot.dataset.height, autosize: true });
      if (isNarrow(plot.clientWidth)) redraw(plot);
    }
  };

  // What scrolls can be reached by the keyboard; what does not is no stop on its way.
  const scrolls = [...document.querySelectorAll(".scroll")];
  const reach = () => {
    for (const area of scrolls) area.tabIndex = area.scrollWidth > area.clientWidth ? 0 : -1;
  };
  const resized = new ResizeObserver(reach);
  scrolls.forEach((area) => resized.observe(area));

  // A phone that is turned, or a window drawn wider, changes how figures are laid out.
  const turned = new ResizeObserver((seen) => {
    for (const { target } of seen) {
      const changed = target.dataset.narrow !== `${isNarrow(target.clientWidth)}`;
      if (drawn.has(target) && target.clientWidth && changed && !matchMedia("print").matches) redraw(target);
    }
  });
  plots.forEach((plot) => turned.observe(plot));

  plots.filter(chooser).forEach(choose);
  const near = new IntersectionObserver(
    (seen) => {
      for (const { target, isIntersecting } of seen) {
        if (!isIntersecting) continue;
        near.unobserve(target);
        setTimeout(draw, 0, target); // one by one: a reader who scrolls is not held up
      }
    },
    { rootMargin: "800px 0px" },
  );
  requestAnimationFrame(() => setTimeout(() => plots.forEach((plot) => near.observe(plot))));
  window.addEventListener("beforeprint", toPaper);
  window.addEventListener("afterprint", toScreen);
})();
