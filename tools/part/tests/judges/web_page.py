#!/usr/bin/python3
"""Drive the points page in headless Chromium: pick points, meet a collision, go round it, save.

web_page.py RTECCTL SCREENSHOT.png      needs Debian's chromium, chromium-driver, python3-selenium and python3-ezdxf
"""
import re
import subprocess
import sys
import tempfile
import urllib.error
import urllib.request
from pathlib import Path

import ezdxf
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select, WebDriverWait

rtecctl, screenshot = sys.argv[1:]
folder = Path(tempfile.mkdtemp())
passed = 0


def check(what, holds):
    global passed
    assert holds, what
    passed += 1
    print("ok", what)


drawing = ezdxf.new("R2010")
drawing.header["$INSUNITS"] = 1
space = drawing.modelspace()
space.add_arc((5, 0), 1.5, 0, 90)
for a, b in [((5, 1.5), (4.55, 1.5)), ((4.55, 1.5), (4.55, 1.8)), ((4.55, 1.8), (3, 1.8))]:
    space.add_line(a, b)
drawing.saveas(folder / "nose.dxf")

server = subprocess.Popen(
    [rtecctl, "part", "points", folder / "nose.dxf", "--feature", "F1:20", "--tip-mm", "2.5", "--web",
     "--out", folder / "out"], stderr=subprocess.PIPE, text=True)
# What the verb has to say of the drawing comes before its address.
url = next(found.group() for line in server.stderr if (found := re.search(r"http://127\.0\.0\.1:\d+/[0-9a-f]{32}/", line)))

bare = re.match(r"http://[^/]+/", url).group()
for secretless in [bare, bare + "plan", bare + "0" * 32 + "/plan"]:
    try:
        urllib.request.urlopen(secretless)
        check(f"{secretless} is refused", False)
    except urllib.error.HTTPError as refused:
        check("an address without the secret is refused", refused.code == 403)
for header in [{"Host": "elsewhere.example"}, {"Origin": "http://elsewhere.example"}]:
    try:
        urllib.request.urlopen(urllib.request.Request(url + "plan", headers=header))
        check(f"a foreign {header} is refused", False)
    except urllib.error.HTTPError as refused:
        check(f"a foreign {header} is refused", refused.code == 403)

options = webdriver.ChromeOptions()
for argument in ["--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1300,850"]:
    options.add_argument(argument)
browser = webdriver.Chrome(service=Service("/usr/bin/chromedriver"), options=options)
try:
    browser.get(url)
    status = lambda: browser.find_element(By.ID, "status").text
    until = lambda text: WebDriverWait(browser, 20).until(lambda _: text in status())
    rows = lambda: len(browser.find_elements(By.CSS_SELECTOR, "#list tr"))
    until("20 points, 0 collisions")
    check("the points of the command line are drawn", rows() == 20)
    view = browser.find_element(By.ID, "view")

    def click(z, x):
        """Click at a place of the part, in mm."""
        at = browser.execute_script(
            "const v=document.getElementById('view'),p=new DOMPoint(arguments[0],-arguments[1])"
            ".matrixTransform(v.getScreenCTM()),r=v.getBoundingClientRect();"
            "return [p.x-r.x-r.width/2,p.y-r.y-r.height/2]", z, x)
        ActionChains(browser).move_to_element_with_offset(view, round(at[0]), round(at[1])).click().perform()

    click(85.0, 48.0)
    until("21 points, 1 collisions")
    check("a click adds a point to the larger cylinder", browser.find_elements(By.CSS_SELECTOR, "#list tr")[20].text.split()[1] == "F4")
    check("the way over the step is shown as a collision", "meets F3 on the way to point 21" in browser.find_element(By.ID, "hits").text)
    check("the hit is drawn", len(browser.find_elements(By.CSS_SELECTOR, ".hit")) == 1)
    browser.find_element(By.ID, "bypasses").click()
    until("21 points, 0 collisions")
    check("by-passes clear it", browser.find_elements(By.CSS_SELECTOR, ".way") != [])
    browser.save_screenshot(screenshot)
    browser.find_elements(By.CSS_SELECTOR, ".point")[3].click()
    until("20 points, 0 collisions")
    check("a click on a point removes it", rows() == 20)
    Select(browser.find_element(By.ID, "mode")).select_by_value("bypass")
    Select(browser.find_element(By.ID, "before")).select_by_value("5")
    click(168.0, 45.0)
    until("20 points")
    browser.find_element(By.ID, "save").click()
    until("Saved in")
    path = (folder / "out" / "pathfin.cdl").read_text()
    check("the path is saved", path.count("touch") == 20 and path.count("start") == 20 and path.count("finish") == 20)
    check("with both kinds of by-pass", path.count("bypass") >= 2)
    check("and the expected trips", (folder / "out" / "probpath.cdl").read_text().count("POINT touch") == 20)
    browser.find_element(By.ID, "done").click()
    check("Done ends the server", server.wait(timeout=20) == 0)
finally:
    browser.quit()
    server.kill()
print(f"{passed} passed, 0 failed")
