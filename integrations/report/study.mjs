// Opens the page of `gdibl study` in a headless Chromium.
//
//   cargo build --release && npm ci && node study.mjs [STUDY.html…]      (pages that are there, or one that is made here)
//
// CHROMIUM and GDIBL: as for check.mjs; pictures go into out/.
//
// 1. What to do, how long it takes, and whether the error bar can be trusted are on the first screen, at 1280 and 600 pixels.
// 2. The page is not wider than the window: tables scroll by themselves.
// 3. The figure is drawn: its points lie inside it. No error in the console, no request but for the page itself.
import { execFileSync } from 'node:child_process';
import { mkdirSync } from 'node:fs';
import { basename, join, resolve } from 'node:path';
import { pathToFileURL } from 'node:url';
import { chromium } from 'playwright-core';

const here = import.meta.dirname;
const repository = join( here, '../..' );
const out = join( here, 'out' );
const gdibl = process.env.GDIBL ?? join( repository, 'target/release/gdibl' );
mkdirSync( out, { recursive: true } );

let failed = 0;
const verdict = ( good, text ) => { console.log( `${ good ? 'ok      ' : 'FAILED  ' } ${ text }` ); failed += ! good; };

let pages = process.argv.slice( 2 ).map( ( page ) => resolve( page ) );
if ( ! pages.length ) {

	const box = join( repository, 'assets/uffizi-box/uffizi-box.bake.toml' );
	const quick = [ '--counts', '2,2,2', '--budgets', '64,256', '--repeats', '2', '--methods', 'gdibl,path', '--quiet', '-o', 'study' ];
	execFileSync( gdibl, [ 'study', box, ...quick ], { cwd: out, stdio: 'pipe' } );
	pages = [ join( out, 'study.html' ) ];

}

const browser = await chromium.launch( { executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', args: [ '--no-sandbox' ] } );
for ( const file of pages ) {

	const name = basename( file, '.html' );
	for ( const width of [ 1280, 600 ] ) {

		const height = 900;
		const page = await browser.newPage( { viewport: { width, height } } );
		const said = [];
		page.on( 'console', ( message ) => said.push( message.text() ) );
		page.on( 'pageerror', ( error ) => said.push( String( error ) ) );
		page.on( 'request', ( request ) => { if ( request.url() !== pathToFileURL( file ).href ) said.push( `asked for ${ request.url() }` ); } );
		await page.goto( pathToFileURL( file ).href );
		const found = await page.evaluate( () => {

			const bottom = ( element ) => element?.getBoundingClientRect().bottom ?? Infinity;
			const lines = [ ...document.querySelectorAll( '.verdict p' ) ];
			const figure = document.querySelector( 'svg' ).getBoundingClientRect();
			// What is cut at the figure's edge is drawn past it.
			const all = [ ...document.querySelectorAll( 'svg circle, svg path, svg rect, svg polyline' ) ];
			const marks = all.filter( ( mark ) => ! mark.closest( '[clip-path], clipPath' ) ).map( ( mark ) => mark.getBoundingClientRect() );
			return {
				advice: bottom( lines.find( ( line ) => line.textContent.startsWith( 'advice: ' ) ) ),
				trust: bottom( lines.find( ( line ) => line.textContent.includes( 'the noise that bakes state' ) ) ),
				text: lines[ 0 ].textContent,
				wide: document.documentElement.scrollWidth,
				marks: marks.length,
				outside: marks.filter( ( mark ) => mark.left < figure.left - 1 || mark.right > figure.right + 1 || mark.top < figure.top - 1 || mark.bottom > figure.bottom + 1 ).length,
			};

		} );
		verdict( found.advice <= height && found.trust <= height, `${ name }, ${ width } pixels: advice and trust end at ${ Math.round( found.advice ) } and ${ Math.round( found.trust ) } of ${ height }` );
		verdict( / s of CPU/.test( found.text ), `${ name }, ${ width } pixels: the advice says how long: ${ found.text }` );
		verdict( found.wide <= width, `${ name }, ${ width } pixels: the page is ${ found.wide } wide` );
		verdict( found.marks > 10 && found.outside === 0, `${ name }, ${ width } pixels: ${ found.marks } marks, ${ found.outside } of them outside of the figure` );
		verdict( said.length === 0, `${ name }, ${ width } pixels: ${ said.length ? said.join( '; ' ) : 'nothing in the console, no request' }` );
		await page.screenshot( { path: join( out, `${ name }.${ width }.png` ) } );
		await page.close();

	}

}

await browser.close();
process.exit( failed ? 1 : 0 );
