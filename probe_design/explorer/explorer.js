// What the server cannot do: drag and move the tumours of the section, and hand over the address.
addEventListener("DOMContentLoaded", () => {
  const find = (event) => event.target.closest?.("[data-tumour]");
  const round = (number) => Math.round(100 * number) / 100;
  const send = (index, x, depth) => emitEvent("explorer_move", { index: index, x: round(x), depth: round(depth) });
  let dragged = null;
  let last = 0;
  addEventListener("pointerdown", (event) => {
    const tumour = find(event);
    if (!tumour) return;
    const box = tumour.ownerSVGElement;
    dragged = { index: Number(tumour.dataset.tumour), box: box.viewBox.baseVal, inverse: box.getScreenCTM().inverse() };
    event.preventDefault();
  });
  const move = (event) => {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(dragged.inverse);
    const { x, y, width, height } = dragged.box;
    send(dragged.index, Math.min(Math.max(at.x, x), x + width), Math.min(Math.max(at.y, 0.1), y + height));
  };
  addEventListener("pointermove", (event) => {
    if (!dragged || event.timeStamp - last < 40) return;  // 25 messages a second
    last = event.timeStamp;
    move(event);
  });
  addEventListener("pointerup", (event) => {
    if (dragged) move(event);
    dragged = null;
  });
  addEventListener("keydown", (event) => {
    const tumour = find(event);
    const step = { ArrowLeft: [-0.5, 0], ArrowRight: [0.5, 0], ArrowUp: [0, -0.5], ArrowDown: [0, 0.5] }[event.key];
    if (!tumour || !step) return;
    event.preventDefault();
    const index = tumour.dataset.tumour;
    send(Number(index), Number(tumour.getAttribute("cx")) + step[0], Number(tumour.getAttribute("cy")) + step[1]);
    const focus = new MutationObserver(() => document.querySelector(`[data-tumour="${index}"]`)?.focus());
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
