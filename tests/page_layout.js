// Opens each page in a frame of each width and reports what does not fit, as [width, page, fault, text].
// PAGES and WIDTHS are put in front of this text by page_layout.py.
const faults = [];

function wordsOf(cell) {
  // Words of code are whole; prose may be broken after a hyphen or a slash.
  const walker = cell.ownerDocument.createTreeWalker(cell, NodeFilter.SHOW_TEXT);
  const words = [];
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const isCode = node.parentElement.closest("code") !== null;
    for (const match of node.data.matchAll(isCode ? /\S+/g : /[^\s\-/–·]+/g)) {
      const range = cell.ownerDocument.createRange();
      range.setStart(node, match.index);
      range.setEnd(node, match.index + match[0].length);
      words.push(range);
    }
  }
  return words;
}

function isBroken(range) {
  const parts = [...range.getClientRects()].filter((part) => part.width > 0.5);
  const tops = parts.map((part) => part.top);
  return parts.length > 1 && Math.max(...tops) - Math.min(...tops) > parts[0].height / 2;
}

function check(view, page, width) {
  const say = (fault, text) => faults.push([width, page, fault, text.trim().slice(0, 80)]);
  const isCut = (element) => element.scrollWidth > element.clientWidth + 1;
  const all = (selector) =>
    [...view.document.querySelectorAll(selector)].filter((element) => element.getClientRects().length > 0);
  if (isCut(view.document.documentElement)) say("page is wider than the window", "");
  for (const image of view.document.images) if (image.naturalWidth === 0) say("image is missing", image.src);
  for (const code of all("article pre > code")) if (isCut(code)) say("code is cut", code.textContent);
  for (const cell of all("article td, article th"))
    for (const word of wordsOf(cell)) if (isBroken(word)) say("word is broken", word.toString());
  if (width >= 1000) for (const table of all(".md-typeset__scrollwrap")) if (isCut(table)) say("table is cut", table.textContent);
}

async function checkAll() {
  for (const page of PAGES) {
    const frame = document.createElement("iframe");
    Object.assign(frame, { width: WIDTHS[0], height: 900, src: page });
    document.body.append(frame);
    await new Promise((done) => (frame.onload = done));
    for (const width of WIDTHS) {
      frame.width = width;
      await new Promise((done) => setTimeout(done, 50)); // for scripts that listen to the width
      check(frame.contentWindow, page, width);
    }
    frame.remove();
  }
}

checkAll()
  .catch((error) => faults.push([0, "", "error", String(error)]))
  .then(() => fetch("/faults", { method: "POST", body: JSON.stringify(faults) }));
