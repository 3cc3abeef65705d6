// Lays a figure out for a screen as narrow as a phone's: panels below each other, legend and scale below the axes.
"use strict";
window.Narrow = (() => {
  const WIDEST = 560; // px from which on a figure stays as it was made
  const AXES = { left: 52, right: 10, row: 18, letter: 6, panel: 190, gap: 62, widest: 44, name: 20, row_name: 24, names: 12, line: 13 };

  const axes = (layout, letter) => Object.keys(layout).filter((name) => name.startsWith(`${letter}axis`));
  const plain = (words) => words.replace(/<[^<>]*>/g, "");
  const longest = (words) => Math.max(...words.map((one) => one.length));
  const domain = (axis) => axis.domain ?? [0, 1];
  const same = (one, other) => one.every((value, k) => Math.abs(value - other[k]) < 1e-3);

  // Pairs of axes, from the top left on; axes that lie over others belong to their pair.
  const panels = (data, layout) => {
    const found = new Map();
    for (const trace of data) {
      if (trace.type === "scatter3d") continue;
      const [x, y] = ["x", "y"].map((letter) => `${letter}axis${(trace[`${letter}axis`] ?? letter).slice(1)}`);
      found.set(`${x} ${y}`, { x, y, across: domain(layout[x] ?? {}), up: domain(layout[y] ?? {}) });
    }
    return [...found.values()].sort((a, b) => b.up[1] - a.up[1] || a.across[0] - b.across[0]);
  };

  const titled = (layout, { across, up }) =>
    (layout.annotations ?? []).filter(
      (note) =>
        note.xref === "paper" && note.yref === "paper" &&
        Math.abs(note.x - (across[0] + across[1]) / 2) < 1e-3 && Math.abs(note.y - up[1]) < 0.03,
    );

  // Panels that stand beside each other come below each other.
  const stack = (data, layout) => {
    const all = panels(data, layout);
    const beside = all.some((one) => all.some((other) => same(one.up, other.up) && !same(one.across, other.across)));
    if (!beside) return;
    // A title above a column of panels is that of each of them.
    const titles = all.map((panel) => {
      const own = titled(layout, panel);
      const above = own.length ? null : all.find(({ across, up }) => same(across, panel.across) && up[1] > 1 - 1e-3);
      return above ? titled(layout, above).map((note) => ({ ...note })) : own;
    });
    layout.annotations?.push(...titles.flat().filter((note) => !layout.annotations.includes(note)));
    const inner = all.length * AXES.panel + (all.length - 1) * AXES.gap;
    const x = new Map(all.map((panel) => [panel.x, layout[panel.x] ?? {}]));
    const lowest = Math.min(...all.map(({ up }) => up[0]));
    const below = all.find(({ up }) => up[0] === lowest);
    all.forEach((panel, k) => {
      const top = 1 - (k * (AXES.panel + AXES.gap)) / inner;
      const title = x.get(panel.x).title?.text ? x.get(panel.x).title : layout[below.x]?.title;
      layout[panel.x] = { ...layout[panel.x], domain: [0, 1], showticklabels: true, title: title && { ...title, standoff: 4 } };
      const own = all.find(({ up, across }) => same(up, panel.up) && across[0] < 1e-3);
      const side = layout[panel.y]?.title?.text ? layout[panel.y].title : layout[own?.y]?.title;
      layout[panel.y] = { ...layout[panel.y], domain: [top - AXES.panel / inner, top], showticklabels: true, title: side };
      for (const note of titles[k]) Object.assign(note, { x: 0.5, y: top });
    });
    layout.height = inner + layout.margin.t + layout.margin.b;
  };

  // The scale of colours lies below; where the cells say their numbers it is not needed.
  const scales = (data, layout) => {
    let moved = 0;
    const lay = (bar) => {
      moved = 46;
      const title = bar.title && { ...bar.title, side: "right" };
      return { ...bar, title, orientation: "h", thickness: 10, len: 1, x: 0.5, xanchor: "center", yref: "container", y: 0, yanchor: "bottom" };
    };
    for (const trace of data) {
      if (!trace.colorbar || trace.showscale === false) continue;
      if (trace.texttemplate) trace.showscale = false;
      else trace.colorbar = lay(trace.colorbar);
    }
    for (const name of Object.keys(layout).filter((key) => key.startsWith("coloraxis")))
      if (layout[name].colorbar) layout[name].colorbar = lay(layout[name].colorbar);
    layout.margin.b += moved;
    layout.height += moved;
    return moved;
  };

  const legend = (data, layout, width, above) => {
    const named = new Set(data.filter((trace) => trace.showlegend !== false && trace.name).map((trace) => trace.name));
    if (layout.showlegend === false || named.size < (layout.legend ? 1 : 2)) return;
    const lines = [...named].flatMap((name) => name.split("<br>"));
    const widest = Math.max(...lines.map((line) => line.length)) * AXES.letter + 46;
    const rows = Math.ceil(named.size / Math.max(1, Math.floor((width - 10) / widest)));
    const room = Math.max(0, Math.min(34, layout.margin.t - 30)); // where the legend was
    layout.margin.t -= room;
    layout.height -= room;
    const high = rows * AXES.row * (lines.length > named.size ? 1.6 : 1) + 14;
    layout.legend = { ...layout.legend, orientation: "h", x: 0, xanchor: "left", yref: "container", yanchor: "bottom", y: above / (layout.height + high) };
    layout.margin.b += high;
    layout.height += high;
  };

  // Words that are wider than the screen go on in a second line.
  const wrapped = (words) => split(words, AXES.widest);
  const split = (words, widest) => {
    if (!words || words.length <= widest || /[<&]/.test(words)) return words;
    const spaces = [...words.matchAll(/ /g)].map(({ index }) => index);
    const middle = spaces.toSorted((a, b) => Math.abs(a - words.length / 2) - Math.abs(b - words.length / 2))[0];
    return middle ? `${words.slice(0, middle)}<br>${words.slice(middle + 1)}` : words;
  };

  // Names of bars go on in a second line, and the words behind bars end inside the figure.
  const bars = (data, layout, width) => {
    const words = data.find((trace) => trace.mode === "text" && trace.textposition === "middle right");
    const names = layout.yaxis?.categoryarray;
    if (!words || !names) return;
    const lines = names.map((name) => split(name, AXES.name));
    layout.yaxis = { ...layout.yaxis, tickvals: names, ticktext: lines };
    const side = longest(lines.flatMap((line) => line.split("<br>"))) * AXES.letter + 12;
    layout.margin.l = Math.max(layout.margin.l, side);
    const inner = width - layout.margin.l - layout.margin.r;
    const [low, high] = layout.xaxis.range;
    const needed = words.x.map((x, k) => low + ((x - low) * inner) / Math.max(inner - plain(words.text[k]).length * AXES.letter, 40));
    layout.xaxis = { ...layout.xaxis, range: [low, Math.max(high, ...needed)] };
  };

  // Long names beside points go on in a second line, too.
  const rows = (data, layout) => {
    if (layout.yaxis?.type !== "category" || layout.yaxis.tickvals) return;
    const names = [...new Set(data.flatMap(({ y }) => (Array.isArray(y) ? y : [])))];
    if (!names.length || longest(names.map(plain)) <= AXES.row_name) return;
    layout.yaxis = { ...layout.yaxis, tickvals: names, ticktext: names.map((name) => split(name, AXES.row_name)) };
    layout.height += names.length * AXES.line * 0.6;
  };

  // Names below an axis are turned where they would cover each other: none may be left out.
  const turned = (layout, width) => {
    for (const name of axes(layout, "x")) {
      const axis = layout[name];
      const names = axis.ticktext?.map(plain) ?? [];
      const inner = (width - layout.margin.l - layout.margin.r) / Math.max(names.length, 1);
      if (axis.tickangle || !names.every((one) => /[a-z]{3}/i.test(one)) || longest(names) * AXES.letter < inner) continue;
      if (names.length > AXES.names) continue;
      layout[name] = { ...axis, tickangle: -40 };
      const high = Math.round(longest(names) * AXES.letter * Math.sin((40 * Math.PI) / 180));
      layout.margin.b += high;
      layout.height += high;
    }
  };

  // Labels that a figure sets itself stand apart; the first one stays.
  const thin = (layout, width) => {
    for (const letter of ["x", "y"])
      for (const name of axes(layout, letter)) {
        const axis = layout[name];
        const count = axis.tickvals?.length ?? 0;
        if (count < 2 || axis.categoryarray || typeof axis.tickvals[0] !== "number") continue;
        const inner = letter === "x" ? width - layout.margin.l - layout.margin.r : layout.height - layout.margin.t - layout.margin.b;
        const [low, high] = axis.range ?? [axis.tickvals[0], axis.tickvals[count - 1]];
        const high_px = axis.tickangle || letter === "y" ? AXES.line : longest(axis.ticktext.map(plain)) * AXES.letter + 6;
        let last = -Infinity;
        const kept = axis.tickvals.map((value) => {
          const place = ((value - low) / (high - low)) * inner;
          if (Math.abs(place - last) < high_px) return false;
          last = place;
          return true;
        });
        const left = (list) => list.filter((_, k) => kept[k]);
        layout[name] = { ...axis, tickvals: left(axis.tickvals), ticktext: left(axis.ticktext) };
      }
  };

  // A title below the axis is no wider than the axis.
  const titles = (data, layout, width) => {
    const named = layout.yaxis?.ticktext?.flatMap((text) => text.split("<br>")) ?? data.flatMap(({ y }) => (Array.isArray(y) ? y : []));
    const side = longest(["", ...named.filter((name) => typeof name === "string").map(plain)]) * AXES.letter;
    const inner = width - Math.max(layout.margin.l, side) - layout.margin.r;
    for (const name of axes(layout, "x")) {
      const title = layout[name].title;
      if (!title?.text || title.text.length * AXES.letter <= inner) continue;
      layout[name] = { ...layout[name], title: { ...title, text: split(title.text, Math.floor(inner / AXES.letter)) } };
      layout.margin.b += AXES.line;
      layout.height += AXES.line;
    }
  };

  const into = (data, layout, width) => {
    if (width >= WIDEST) return;
    for (const trace of data) if (trace.name) trace.name = wrapped(trace.name);
    for (const note of layout.annotations ?? []) note.text = wrapped(note.text);
    layout.margin = { ...layout.margin, l: Math.min(layout.margin.l, AXES.left), r: AXES.right };
    layout.font = { ...layout.font, size: 10 };
    if (layout.scene) {
      layout.height = 430;
      layout.margin.t = 0;
    }
    if (!layout.scene) {
      stack(data, layout);
      bars(data, layout, width);
      rows(data, layout);
      turned(layout, width);
      thin(layout, width);
      titles(data, layout, width);
    }
    for (const note of layout.annotations ?? []) if (note.font?.size > 11) note.font = { ...note.font, size: 11 };
    for (const trace of data) if (trace.textfont?.size > 10) trace.textfont = { ...trace.textfont, size: 9 };
    legend(data, layout, width, scales(data, layout));
  };

  return { into, WIDEST };
})();
