"""Style sheet and script of a report: small, printable, and without access to a network."""

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2rem; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; margin: .4rem 0; font-size: .9rem; }
td, th { border: 1px solid #ddd; padding: .2rem .5rem; text-align: left; vertical-align: top; font-weight: normal; }
th { background: #f4f4f4; } td { font-variant-numeric: tabular-nums; }
summary { cursor: pointer; } body > table { display: block; overflow-x: auto; }
figure { position: relative; margin: 1rem 0; } figure svg { width: 100%; height: auto; display: block; }
pre { background: #f7f7f7; padding: .8rem; overflow-x: auto; font-size: .85rem; }
.tip { position: absolute; pointer-events: none; background: #fff; border: 1px solid #888; border-radius: 4px;
  padding: .2rem .5rem; font-size: .8rem; white-space: nowrap; display: none; }
.dot { position: absolute; pointer-events: none; width: 8px; height: 8px; margin: -4px; border-radius: 50%;
  border: 2px solid #d55e00; display: none; }
@media print { body { max-width: none; margin: 0; } figure, table { break-inside: avoid; } }
"""

SCRIPT = """
for (const figure of document.querySelectorAll("figure")) {
  const axes = JSON.parse(figure.querySelector("script").textContent), svg = figure.querySelector("svg");
  const [tip, dot] = ["tip", "dot"].map(name => {
    const part = document.createElement("div"); part.className = name; figure.append(part); return part;
  });
  const share = (value, [low, high, log]) => log ? Math.log(value / low) / Math.log(high / low)
    : (value - low) / (high - low);
  const back = (part, [low, high, log]) => log ? low * Math.pow(high / low, part) : low + part * (high - low);
  const hide = () => { tip.style.display = dot.style.display = "none"; };
  svg.addEventListener("mouseleave", hide);
  svg.addEventListener("mousemove", event => {
    const frame = svg.getBoundingClientRect();
    const at = [event.clientX - frame.left, event.clientY - frame.top];
    const inside = axes.find(({box}) => at[0] >= box[0] * frame.width && at[0] <= box[2] * frame.width
      && at[1] >= box[1] * frame.height && at[1] <= box[3] * frame.height);
    if (!inside) return hide();
    const {box, x, y, curves} = inside, wide = box[2] - box[0], high = box[3] - box[1];
    const place = (a, b) => [(box[0] + share(a, x) * wide) * frame.width, (box[3] - share(b, y) * high) * frame.height];
    let best = {far: 30};
    for (const {label, x: xs, y: ys} of curves) xs.forEach((a, i) => {
      const spot = place(a, ys[i]), far = Math.hypot(spot[0] - at[0], spot[1] - at[1]);
      if (far < best.far) best = {far, label, value: [a, ys[i]], spot};
    });
    const value = best.value || [back((at[0] / frame.width - box[0]) / wide, x),
      back((box[3] - at[1] / frame.height) / high, y)];
    const words = [x, y].map((axis, i) => `${axis[3]}: ${Number(value[i].toPrecision(5))}`);
    tip.textContent = (best.label ? [best.label, ...words] : words).join("  ·  ");
    const spot = best.spot || at, left = spot[0] > frame.width / 2;
    tip.style.display = "block";
    tip.style.top = `${spot[1] + 10}px`;
    tip.style.left = left ? "" : `${spot[0] + 10}px`;
    tip.style.right = left ? `${frame.width - spot[0] + 10}px` : "";
    dot.style.display = best.spot ? "block" : "none";
    [dot.style.left, dot.style.top] = spot.map(part => `${part}px`);
  });
}
"""
