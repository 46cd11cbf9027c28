// What is wrong with the layout: parts that overlap, stick out, do not show all of their text, or are covered.
(needed) => {
  const shown = (element) => element.checkVisibility() && element.getBoundingClientRect().width > 0;
  const name = (element) => element.id || element.className || element.tagName;
  const wrong = [];
  if (document.documentElement.scrollWidth > innerWidth) wrong.push(`the page is ${document.documentElement.scrollWidth} px wide`);
  for (const selector of needed) {
    const element = document.querySelector(selector), box = element.getBoundingClientRect();
    const top = document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2);
    const outside = box.left < 0 || box.right > innerWidth || box.top < 0 || box.bottom > innerHeight;
    if (!shown(element) || outside) wrong.push(`${selector} is not on the screen`);
    else if (!element.contains(top) && !top?.contains(element)) wrong.push(`${selector} is covered by ${name(top)}`);
  }
  const parts = [...document.querySelectorAll("header > *, #hero .fact, .bars > *, main > .panel")].filter(shown);
  for (const element of parts) {
    const shortened = ["run", "message"].includes(element.id);
    if (!shortened && element.scrollWidth > element.clientWidth + 1) wrong.push(`${name(element)} is cut: ${element.textContent.slice(0, 60)}`);
  }
  for (const [i, a] of parts.entries()) {
    for (const b of parts.slice(i + 1)) {
      const [p, q] = [a.getBoundingClientRect(), b.getBoundingClientRect()];
      const wide = Math.min(p.right, q.right) - Math.max(p.left, q.left), high = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
      if (!a.contains(b) && !b.contains(a) && wide > 1 && high > 1) wrong.push(`${name(a)} and ${name(b)} overlap`);
    }
  }
  return wrong;
}
