// Hands out the numbers of a figure, or the cells of a table, as a CSV file made in the page.
"use strict";
(() => {
  const KINDS = {
    i1: Int8Array, u1: Uint8Array, u1c: Uint8ClampedArray, i2: Int16Array, u2: Uint16Array,
    i4: Int32Array, u4: Uint32Array, f4: Float32Array, f8: Float64Array,
  };
  // What would be a column, were it not the same for all points or about looks alone.
  const MEASURES = [
    "x", "y", "z", "base", "q1", "median", "q3", "lowerfence", "upperfence", "mean", "sd", "text", "customdata",
  ];

  const plain = (text) => {
    const words = `${text ?? ""}`.replace(/<br\s*\/?>/g, " ").replace(/<sup>/g, "^"); // powers stay powers
    return new DOMParser().parseFromString(words, "text/html").body.textContent.trim();
  };

  // plotly.py writes arrays of numbers as base64.
  const listed = (values) => {
    if (!values?.bdata) return Array.isArray(values) ? values : null;
    const bytes = Uint8Array.from(atob(values.bdata), (c) => c.charCodeAt(0));
    const flat = Array.from(new KINDS[values.dtype](bytes.buffer));
    const shape = `${values.shape ?? flat.length}`.split(",").map(Number);
    if (shape.length < 2) return flat;
    return Array.from({ length: shape[0] }, (_, k) => flat.slice(k * shape[1], (k + 1) * shape[1]));
  };

  const axisOf = (layout, trace, letter) => {
    const own = trace[`${letter}axis`] ?? letter;
    return (trace.type === "scatter3d" ? layout.scene : layout)?.[`${letter}axis${own.slice(1)}`] ?? {};
  };

  // The title of a panel is a note above the middle of its axes.
  const panelOf = (layout, trace) => {
    const [across, up] = ["x", "y"].map((letter) => axisOf(layout, trace, letter).domain ?? [0, 1]);
    const above = (note) =>
      note.xref === "paper" && note.yref === "paper" &&
      Math.abs(note.x - (across[0] + across[1]) / 2) < 1e-3 && Math.abs(note.y - up[1]) < 1e-3;
    return plain(layout.annotations?.find(above)?.text);
  };

  const matrixRows = (trace) => {
    const [x, y, z, text] = ["x", "y", "z", "text"].map((name) => listed(trace[name]));
    return z.flatMap((row, i) =>
      row.map((value, j) => ({ x: x?.[j] ?? j, y: y?.[i] ?? i, z: value, ...(text && { text: text[i]?.[j] }) })),
    );
  };

  // Categories within categories come level by level, all else point by point.
  const perPoint = (name, values) =>
    "xy".includes(name) && Array.isArray(values?.[0])
      ? values[0].map((_, k) => values.map((level) => level[k]).join(", "))
      : values;

  const pointRows = (trace) => {
    const columns = MEASURES.map((name) => [name, perPoint(name, listed(trace[name]))]);
    for (const letter of ["x", "y", "z"]) {
      const { array, arrayminus } = trace[`error_${letter}`] ?? {};
      columns.push([`${letter} bar up`, listed(array)], [`${letter} bar down`, listed(arrayminus)]);
    }
    const there = columns.filter(([, values]) => values);
    const count = Math.max(0, ...there.map(([, values]) => values.length));
    const rows = Array.from({ length: count }, (_, k) =>
      Object.fromEntries(there.map(([name, values]) => [name, Array.isArray(values[k]) ? values[k].join(" ") : values[k]])),
    );
    return rows.filter((row) => (row.x ?? "") !== "" || (row.y ?? "") !== ""); // a line is interrupted by nothing
  };

  const cell = (value) => {
    if (typeof value === "number") return Number.isFinite(value) ? `${value}` : "";
    const text = plain(value);
    return text !== "" && Number.isFinite(+text) ? text : guarded(text);
  };

  // A name that begins like a formula would be one in a spreadsheet; a signed number stays as it is.
  const guarded = (text) => (/^[=@\t\r]|^[+-](?!\d(?:(?![A-Za-z]\()[^=|!])*$)/.test(text) ? `'${text}` : text);

  const quoted = (text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);

  const csv = (rows) => rows.map((row) => row.map(quoted).join(",")).join("\n") + "\n";

  // Of a matrix the colours say what its numbers are.
  const titleOf = (layout, trace, letter) => {
    const told = trace.type === "heatmap" && letter === "z" ? trace.colorbar : axisOf(layout, trace, letter);
    return plain(told?.title?.text);
  };

  // Of a 3-D view the numbers that it is drawn from: places, and displacements as they are, not amplified.
  const sceneRows = ({ steps, scene }) => {
    const heads = ["step", "point", "leg", "x (mm)", "y (mm)", "z (mm)", "dx (µm)", "dy (µm)", "dz (µm)", "text"];
    const micrometres = (value) => (value === null ? "" : +(1e3 * value).toPrecision(6));
    const points = steps.flatMap((label, step) =>
      scene.names.map((name, k) => {
        const numbers = [...scene.place[step][k], ...scene.shift[step][k].map(micrometres)];
        return [label, name, scene.leg[k] || "", ...numbers, scene.words[step][k]];
      }),
    );
    return [heads, ...points.map((row) => row.map((value) => cell(value ?? "")))];
  };

  const figureRows = ({ data, layout, steps, scene }) => {
    if (scene) return sceneRows({ steps, scene });
    const titles = data.map((trace) =>
      Object.fromEntries(["x", "y", "z"].map((letter) => [letter, titleOf(layout, trace, letter)])),
    );
    const rows = data.flatMap((trace, k) => {
      const shown = steps?.find(({ args }) => args[0].visible[k] === true)?.label;
      const told = { series: trace.name, panel: panelOf(layout, trace), step: shown };
      const axes = Object.fromEntries(["x", "y", "z"].map((letter) => [`${letter} is`, titles[k][letter]]));
      return (trace.type === "heatmap" ? matrixRows(trace) : pointRows(trace)).map((row) => ({ ...told, ...axes, ...row }));
    });
    const filled = (name) => rows.some((row) => cell(row[name]) !== "");
    const heads = ["series", "panel", "step", ...MEASURES, ...["x", "y", "z"].flatMap((l) => [`${l} bar up`, `${l} bar down`])];
    // An axis that is the same in all panels stands in the head of its column.
    const single = (letter) => (new Set(rows.map((row) => row[`${letter} is`])).size === 1 ? rows[0][`${letter} is`] : "");
    const several = ["x", "y", "z"].filter((letter) => !single(letter)).map((letter) => `${letter} is`);
    const kept = [...heads, ...several].filter(filled);
    const named = kept.map((name) => (single(name) ? `${name}: ${single(name)}` : name));
    return [named, ...rows.map((row) => kept.map((name) => cell(row[name])))];
  };

  const tableRows = (table) =>
    [...table.rows].map((row) => [...row.cells].map((one) => guarded(one.textContent.trim())));

  const contents = (button) => {
    const holder = button.closest("figure, .listing");
    const data = holder.querySelector("script[type='application/json']");
    if (holder.matches("figure")) return csv(figureRows(JSON.parse(data.textContent)));
    return data ? JSON.parse(data.textContent) : csv(tableRows(holder.querySelector("table")));
  };

  const hand = (button) => {
    const text = contents(button);
    // Spreadsheets take UTF-8 for what it is by its mark alone.
    const blob = new Blob([/[^\x00-\x7f]/.test(text) ? "\ufeff" : "", text], { type: "text/csv;charset=utf-8" });
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = button.dataset.file;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  };

  for (const button of document.querySelectorAll("button.csv")) button.addEventListener("click", () => hand(button));
})();
