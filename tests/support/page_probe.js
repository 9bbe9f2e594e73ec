// What the tests read out of the page, in one look.
(() => {
  const all = (selector, read) => [...document.querySelectorAll(selector)].map(read);
  return {
    sequence: document.querySelector(".numbers")?.dataset.sequence ?? "",
    values: Object.fromEntries(all("td.value[id]", cell => [cell.id, cell.textContent])),
    verdict: document.getElementById("verdict")?.textContent ?? "",
    kind: document.getElementById("verdict")?.className ?? "",
    pictures: all("figure.target", figure => figure.dataset.sequence).filter(Boolean),
    causes: Object.fromEntries(all(".causes li", item => [item.dataset.code, item.querySelector(".remedy").textContent])),
    plots: document.querySelectorAll(".plot .uplot").length,
    overflow: document.documentElement.scrollWidth - document.documentElement.clientWidth,
    focused: document.activeElement.textContent,
  };
})()
