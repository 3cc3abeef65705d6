// What a 3-D view shows of its scene: a step, an amplification, and the legs that a reader has chosen.
"use strict";
window.Scene = (() => {
  const known = (point) => point.every((value) => value !== null);
  const NOTHING = [null, null, null];

  const shown = (scene, { step, gain, legs }) => {
    const times = scene.gains[gain];
    const start = scene.place[step];
    const end = start.map((point, k) => point.map((value, i) => value + times * scene.shift[step][k][i]));
    const measured = scene.names.map((_, k) => known(start[k]) && known(scene.shift[step][k]));
    const ofLeg = scene.leg.map((leg) => legs.includes(leg));
    const there = measured.map((is, k) => is && (!scene.own[k] || ofLeg[k]));
    const lit = there.map((is, k) => is && (!legs.length || ofLeg[k]));
    const where = (flags) => flags.flatMap((is, k) => (is ? [k] : []));
    const ring = scene.ring.filter((k) => there[k]);
    const drawsLeg = (leg) => legs.includes(leg) || (scene.allLegs && !legs.length);
    const rods = scene.joints[step].filter((_, k) => drawsLeg(scene.legs[k]));
    const of = (points, chosen) => chosen.map((k) => points[k]);
    const words = (chosen) => chosen.map((k) => scene.words[step][k]);
    const [plain, attached] = [false, true].map((is) => where(there.map((here, k) => here && scene.attached[k] === is)));
    const look = (chosen) =>
      !legs.length ? {} : {
        color: chosen.map((k) => (lit[k] ? scene.colours.chosen : scene.colours.other)),
        size: chosen.map((k) => (lit[k] ? 6 : 3)),
      };
    return [
      { points: of(start, plain), text: words(plain), look: look(plain) },
      { points: of(start, attached), text: words(attached), look: look(attached) },
      { points: where(lit).flatMap((k) => [start[k], end[k], NOTHING]) },
      { points: of(start, ring) },
      { points: of(end, ring) },
      { points: rods.flatMap((joints) => [...joints, NOTHING]) },
      {
        points: rods.flat(),
        text: rods.length
          ? scene.legs.filter(drawsLeg).flatMap((leg) => ["lower", "upper"].map((which) => `leg ${leg}, ${which} joint`))
          : [],
      },
      { points: scene.arrow.length ? scene.arrow[step] : [] },
    ];
  };

  // Names of what belongs to the chosen legs.
  const names = (scene, { step, gain, legs }) =>
    scene.names.flatMap((text, k) => {
      if (!legs.includes(scene.leg[k]) || !known(scene.place[step][k]) || !known(scene.shift[step][k])) return [];
      const [x, y, z] = scene.place[step][k].map((value, i) => value + scene.gains[gain] * scene.shift[step][k][i]);
      return [{ x, y, z, text, showarrow: false, yshift: 10, font: { size: 11 }, bgcolor: "rgba(255,255,255,0.7)" }];
    });

  // The box holds all steps and all legs, so that it stands still while one goes through them.
  const box = (scene, chosen) => {
    const low = [Infinity, Infinity, Infinity];
    const high = low.map((value) => -value);
    const hold = (point) => {
      if (!known(point)) return;
      point.forEach((value, i) => {
        low[i] = Math.min(low[i], value);
        high[i] = Math.max(high[i], value);
      });
    };
    const every = { ...chosen, legs: scene.legs };
    scene.place.forEach((_, step) => shown(scene, { ...every, step }).forEach(({ points }) => points.forEach(hold)));
    const widest = Math.max(...low.map((value, i) => high[i] - value));
    const margin = 0.02 * widest + 1e-6;
    const whole = widest + 2 * margin;
    const ratio = low.map((value, i) => Math.max((high[i] - value + 2 * margin) / whole, 0.35));
    const size = Math.min(1.75 / Math.hypot(...ratio), 0.95 / ratio[2]);
    return { low: low.map((value) => value - margin), high: high.map((value) => value + margin), ratio: ratio.map((r) => r * size) };
  };

  // Puts coordinates into traces; the axes come back.
  const into = (data, scene, chosen) => {
    shown(scene, chosen).forEach(({ points, text, look }, k) => {
      ["x", "y", "z"].forEach((axis, i) => (data[k][axis] = points.map((point) => point[i])));
      if (text) data[k].text = text;
      if (look) Object.assign(data[k].marker, look);
    });
    const { low, high, ratio } = box(scene, chosen);
    const axis = (name, i) => ({ title: { text: `${name} (mm)` }, range: [low[i], high[i]], nticks: 6 });
    return {
      xaxis: axis("x", 0),
      yaxis: axis("y", 1),
      zaxis: axis("z", 2),
      annotations: names(scene, chosen),
      aspectmode: "manual",
      aspectratio: { x: ratio[0], y: ratio[1], z: ratio[2] },
    };
  };

  const length = (mm) => (mm < 1 ? `${+(1e3 * mm).toPrecision(3)} µm` : `${+mm.toPrecision(3)} mm`);

  const scale = (scene, { gain }) => {
    const times = scene.gains[gain];
    return `${times.toLocaleString("en")} times: ${length(scene.scale)} on the axes = ${length(scene.scale / times)}`;
  };

  // Sentences of the chosen legs in this step, and their rows of the table leg by leg.
  const tell = (figure, scene, { step, legs }) => {
    const place = figure.querySelector(".of-legs");
    if (!place) return;
    const said = scene.legs.flatMap((leg, k) => (legs.includes(leg) ? [scene.said[step]?.[k]] : []));
    place.replaceChildren(
      ...said.filter(Boolean).map((words) => Object.assign(document.createElement("p"), { textContent: words })),
    );
    const listing = figure.closest("section").querySelector(".by-leg");
    for (const row of listing?.querySelectorAll("tbody tr") ?? []) {
      const leg = +row.cells[0].textContent.replace("leg ", "");
      row.hidden = legs.length > 0 && !legs.includes(leg);
    }
    const folded = listing?.querySelector("details");
    if (folded && legs.length) folded.open = true;
  };

  return { shown, into, scale, tell };
})();
