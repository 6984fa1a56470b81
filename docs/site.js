// What is wider than its column can be scrolled by keyboard, and each button row of a code block has a name of its own.
const nameRegions = () => {
  for (const region of document.querySelectorAll("pre > code, .md-typeset__scrollwrap"))
    if (!region.hasAttribute("tabindex")) region.tabIndex = 0;
  document.querySelectorAll(".md-code__nav").forEach((row, index) => {
    if (!row.ariaLabel) row.ariaLabel = `Code block ${index + 1}`;
  });
};
new MutationObserver(nameRegions).observe(document.documentElement, { childList: true, subtree: true });
