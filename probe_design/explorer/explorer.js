// What the server cannot do: drag and move tumours and edges of the section, and hand over the address.
document.documentElement.lang = "en"; // which the framework leaves out
addEventListener("DOMContentLoaded", () => {
  const find = (event) => event.target.closest?.("[data-tumour], [data-edge]");
  const round = (number) => Math.round(1000 * number) / 1000;
  const send = (part, x, depth) => {
    const { tumour, edge } = part.dataset;
    emitEvent(edge ? "explorer_edge" : "explorer_move", { name: edge ?? tumour, x: round(x), depth: round(depth) });
  };
  let dragged = null;
  let last = 0;
  addEventListener("pointerdown", (event) => {
    const part = find(event);
    if (!part) return;
    const box = part.ownerSVGElement;
    dragged = { part: part, box: box.viewBox.baseVal, inverse: box.getScreenCTM().inverse(), moved: false };
    event.preventDefault();
  });
  const move = (event) => {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(dragged.inverse);
    const { x, y, width, height } = dragged.box;
    const depth = dragged.part.dataset.edge ? Math.max(at.y, y) : Math.min(Math.max(at.y, 0.1), y + height);
    send(dragged.part, Math.min(Math.max(at.x, x), x + width), depth);
    dragged.moved = true;
  };
  addEventListener("pointermove", (event) => {
    if (!dragged || event.timeStamp - last < 40) return;  // 25 messages a second
    last = event.timeStamp;
    move(event);
  });
  addEventListener("pointerup", (event) => {
    if (dragged?.moved) move(event);
    dragged = null;
  });
  addEventListener("keydown", (event) => {
    const part = find(event);
    const direction = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!part || !direction) return;
    event.preventDefault();
    const { tumour, edge, x, y } = part.dataset;
    const step = edge ? 0.05 : 0.5;  // mm
    const from = edge ? [Number(x), Number(y)] : [Number(part.getAttribute("cx")), Number(part.getAttribute("cy"))];
    send(part, from[0] + step * direction[0], from[1] + step * direction[1]);
    const name = edge ? `[data-edge="${edge}"]` : `[data-tumour="${tumour}"]`;
    const focus = new MutationObserver(() => document.querySelector(name)?.focus());
    focus.observe(document.querySelector(".picture"), { childList: true, subtree: true });
    setTimeout(() => focus.disconnect(), 400);
  });
  // the address is handed over when the page is connected
  const fragment = location.hash.slice(1);
  if (fragment) {
    const wait = setInterval(() => {
      if (!window.socket?.connected) return;
      clearInterval(wait);
      emitEvent("explorer_open", fragment);
    }, 50);
  }
});
