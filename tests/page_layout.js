// Returns what does not fit on a page, as [fault, text].
(() => {
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

  const say = (fault, text) => faults.push([fault, text.trim().slice(0, 80)]);
  const isCut = (element) => element.scrollWidth > element.clientWidth + 1;
  const all = (selector) => [...document.querySelectorAll(selector)].filter((each) => each.getClientRects().length > 0);
  if (isCut(document.documentElement)) say("page is wider than the window", "");
  for (const image of document.images) if (image.naturalWidth === 0) say("image is missing", image.src);
  for (const code of all("article pre > code")) if (isCut(code)) say("code is cut", code.textContent);
  for (const cell of all("article td, article th"))
    for (const word of wordsOf(cell)) if (isBroken(word)) say("word is broken", word.toString());
  if (innerWidth >= 1000)
    for (const table of all(".md-typeset__scrollwrap")) if (isCut(table)) say("table is cut", table.textContent);
  return faults;
})()
