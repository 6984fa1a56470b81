// The live waveform of the bench page: minimum and maximum of each channel in each column, drawn on one canvas.
document.documentElement.lang = "en"; // which the framework leaves out
window.drawWaveform = (wave) => {
  const canvas = document.querySelector("canvas.waveform");
  if (!canvas) return;
  const ratio = devicePixelRatio;
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  const style = getComputedStyle(canvas);
  const colours = ["--inner", "--outer", "--force"].map((name) => style.getPropertyValue(name));
  const ink = style.getPropertyValue("--ink");
  const part = height / Math.max(wave.channels.length, 1);
  pen.font = "11px system-ui, sans-serif";
  wave.channels.forEach((channel, row) => {
    const isKnown = (value) => value !== null;
    const low = Math.min(...channel.low.filter(isKnown));
    const high = Math.max(...channel.high.filter(isKnown), low + 1e-6);
    const place = (value) => (row + 1) * part - 6 - ((part - 24) * (value - low)) / (high - low);
    pen.fillStyle = colours[row % colours.length];
    const step = width / channel.low.length;
    channel.low.forEach((value, k) => {
      if (value === null) return;
      const top = place(channel.high[k]);
      pen.fillRect(k * step, top, Math.max(step, 1), Math.max(place(value) - top, 1.5));
    });
    pen.fillStyle = ink;
    pen.fillText(`${channel.name}: ${low.toPrecision(4)} to ${high.toPrecision(4)} mV, last ${wave.seconds} s`, 4, row * part + 11);
  });
  pen.fillStyle = "#d55e00";
  for (const k of wave.clipped) pen.fillRect((k * width) / 240, 0, Math.max(width / 240, 2), 5);
  document.querySelector(".clipping").hidden = !wave.clipped.length;
  if (wave !== window.lastWaveform) canvas.dataset.frames = Number(canvas.dataset.frames ?? 0) + 1;
  window.lastWaveform = wave;
  canvas.dataset.clipped = wave.clipped.length;
};
const redraw = () => window.lastWaveform && drawWaveform(window.lastWaveform);
addEventListener("resize", redraw);
addEventListener("DOMContentLoaded", () => {
  new MutationObserver(redraw).observe(document.body, { attributes: true, attributeFilter: ["class"] });  // dark or light
});
