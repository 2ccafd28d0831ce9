// Sorts a table by the column whose title is clicked, and backwards if it is clicked again.

const LIKE_TEXT = new Intl.Collator("en", { numeric: true, sensitivity: "base" });

for (const button of document.querySelectorAll("th button")) {
  button.addEventListener("click", () => {
    const head = button.parentElement, falling = head.ariaSort !== "descending";
    const text = (row) => row.cells[head.cellIndex].firstChild?.textContent ?? "";
    const compare = (a, b) => (falling ? -1 : 1) * LIKE_TEXT.compare(text(a), text(b));
    for (const other of head.parentElement.cells) other.ariaSort = null;
    head.ariaSort = falling ? "descending" : "ascending";
    for (const body of head.closest("table").tBodies) {
      body.append(...[...body.rows].filter((row) => row.cells.length > 1).sort(compare));
    }
  });
}
