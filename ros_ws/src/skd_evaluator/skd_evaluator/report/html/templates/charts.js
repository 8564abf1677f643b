// Charts that Vega-Lite draws. Their texts take the colour of the page, so that dark and print need no second drawing.
const THEME = {
  background: "transparent",
  font: 'system-ui, "Segoe UI", "Noto Sans", "DejaVu Sans", sans-serif',
  view: { stroke: null },
  axis: {
    labelColor: "currentColor", titleColor: "currentColor", gridColor: "currentColor", domainColor: "currentColor",
    tickColor: "currentColor", gridOpacity: 0.13, domainOpacity: 0.5, tickOpacity: 0.5, labelFontSize: 12,
    titleFontSize: 12, titleFontWeight: "normal", labelFlush: false, // a number stands below its tick, the last one too
  },
  legend: {
    labelColor: "currentColor", titleColor: "currentColor", labelFontSize: 12, titleFontSize: 12,
    titleFontWeight: "normal", symbolOpacity: 1, orient: "bottom", direction: "horizontal", titleLimit: 400,
  },
};

const views = new Map();
const SHEET = 680; // px of a page of A4 between its margins

// On paper charts are drawn for the paper's width, so that their texts are not scaled with them.
function fitPaper() {
  for (const [target, view] of views) view.signal("width", target.closest(".three") ? SHEET / 2 - 60 : SHEET - 60).run();
}

async function drawAll(charts) {
  for (const target of document.querySelectorAll(".chart[data-chart]")) {
    const spec = charts[target.dataset.chart][Number(target.dataset.index)];
    const columns = Math.max(1, Math.floor((target.clientWidth || 600) / 260));
    const config = { ...THEME, legend: { ...THEME.legend, columns } };
    // `ast`: expressions are interpreted, so that the page needs no right to make code of texts.
    const { view } = await window.vegaEmbed(target, spec, { actions: false, renderer: "svg", ast: true, config, tooltip: { theme: "custom" }, defaultStyle: false });
    views.set(target, view);
  }
}
