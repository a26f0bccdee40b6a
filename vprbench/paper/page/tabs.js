// Tabs that share a panel: `turn(i)` is called for the one that is chosen, by click or by key. `list` may be null.
function Tabs(list, panel, turn) {
  const tabs = [...(list?.children ?? [])];
  const steps = {
    ArrowRight: (i) => (i + 1) % tabs.length,
    ArrowLeft: (i) => (i + tabs.length - 1) % tabs.length,
    Home: () => 0,
    End: () => tabs.length - 1,
  };
  if (list) {
    list.hidden = false;
    panel.setAttribute("role", "tabpanel");
  }
  tabs.forEach((tab, i) => {
    tab.addEventListener("click", () => turn(i));
    tab.addEventListener("keydown", (event) => {
      if (event.altKey || event.ctrlKey || event.metaKey || !(event.key in steps)) return;
      event.preventDefault();
      turn(steps[event.key](i));
      tabs[steps[event.key](i)].focus();
    });
  });

  function mark(chosen) {
    tabs.forEach((tab, i) => {
      tab.setAttribute("aria-selected", String(i === chosen));
      tab.tabIndex = i === chosen ? 0 : -1;
    });
    if (tabs.length) panel.setAttribute("aria-labelledby", tabs[chosen].id);
  }

  return { mark };
}
